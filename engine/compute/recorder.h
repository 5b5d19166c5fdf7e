#pragma once
#include <cstring>
#include <initializer_list>
#include <memory>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include <iclk/engine/compute/descriptor_arena.h>
#include <iclk/engine/compute/stage_timer.h>
#include <iclk/engine/submission.h>

namespace iclk::engine {

class HazardTracker;
enum class Stage : uint8_t;
struct Use;

/// The number of workgroups of a dispatch.
struct Groups {
  uint32_t x = 1, y = 1, z = 1;
};

/// The number of workgroups of `size` invocations that cover `count` invocations.
constexpr uint32_t groups_for(uint32_t count, uint32_t size) { return count / size + (count % size != 0); }

/// Writes commands into a command buffer of iclk or of the application, with the barriers that they need. It uses only global
/// memory barriers of the COMPUTE, TRANSFER and HOST stages. Buffers are identified by their VkBuffer.
///
/// Before its first command a recording waits once for all earlier compute and transfer work on the queue. The application
/// must order its other accesses to buffers and images (graphics, host writes after the submission).
///
/// The recorder submits nothing. The command buffer must be in the recording state. Kernels, buffers, arena and timer must
/// live until the command buffer has executed for the last time. One thread at a time.
class Recorder {
 public:
  Recorder(const Context& context, VkCommandBuffer commands, DescriptorArena& arena, StageTimer* timer = nullptr);
  /// Begins `submission` and records into it. Work that exceeds Submission::most_groups() continues in its next command buffer;
  /// a dispatch may be split. `submission` must outlive the recorder.
  Recorder(Submission& submission, DescriptorArena& arena, StageTimer* timer = nullptr);
  ~Recorder();  ///< records nothing
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;

  /// All later dispatches run no workgroup. Drivers that compile a kernel at its first run, such as lavapipe, then only
  /// compile.
  void compile_only() { compile_only_ = true; }

  /// Names the following commands, for the timer.
  void stage(const char* name);

  /// Binds buffers[i] to binding i, pushes `push` (exactly Kernel::push_constant_bytes()) and dispatches. Records no command
  /// if a group count is 0. Throws Error(invalid_argument) for a mismatch, Error(unsupported) beyond maxComputeWorkGroupCount.
  void dispatch(const Kernel& kernel, std::span<const Buffer* const> buffers, std::span<const std::byte> push, Groups groups);
  void dispatch(const Kernel& kernel, std::initializer_list<const Buffer*> buffers, Groups groups) {
    dispatch(kernel, std::span(buffers.begin(), buffers.size()), {}, groups);
  }
  template <class Push>
  requires std::is_trivially_copyable_v<Push> && std::is_class_v<Push>
  void dispatch(const Kernel& kernel, std::initializer_list<const Buffer*> buffers, const Push& push, Groups groups) {
    dispatch(kernel, std::span(buffers.begin(), buffers.size()), std::as_bytes(std::span(&push, 1)), groups);
  }

  /// Throws Error(invalid_argument) for a region outside either buffer.
  void copy(const Buffer& source, const Buffer& destination, std::span<const VkBufferCopy> regions);
  /// Copies the first `bytes` bytes.
  void copy(const Buffer& source, const Buffer& destination, VkDeviceSize bytes) {
    const VkBufferCopy region{0, 0, bytes};
    copy(source, destination, std::span(&region, 1));
  }
  /// Uploads bytes of a MemoryKind::table that the host writes before the submission. Records nothing if the table itself is
  /// mapped.
  void upload(const Buffer& table, VkDeviceSize offset, VkDeviceSize bytes);
  /// Sets 32-bit words. `offset` and `bytes` are multiples of 4; VK_WHOLE_SIZE: to the end.
  void fill(const Buffer& buffer, uint32_t word = 0, VkDeviceSize offset = 0, VkDeviceSize bytes = VK_WHOLE_SIZE);

  /// Copies mip level 0 of layer 0 to byte `offset`. In the buffer, rows are `row_texels` texels apart (0: rows are packed).
  /// Throws Error(invalid_argument) for an undefined layout, a format without texel_bytes() (format.h), a null handle, an
  /// empty image, or a destination that is too small.
  void copy_image_to_buffer(const ForeignImage& image, const Buffer& destination, VkDeviceSize offset = 0,
                            uint32_t row_texels = 0);

  /// Makes the written buffers visible to the host after the fence of the submission is signalled. Call it last.
  void host_read(std::span<const Buffer* const> buffers);
  void host_read(std::initializer_list<const Buffer*> buffers) { host_read(std::span(buffers.begin(), buffers.size())); }

  /// Makes the written buffers visible to compute and transfer commands that are recorded later without this recorder.
  void publish(std::span<const Buffer* const> buffers);
  void publish(std::initializer_list<const Buffer*> buffers) { publish(std::span(buffers.begin(), buffers.size())); }

  /// Ends the last stage of the timer. Does not end the command buffer.
  void finish();

  uint32_t barriers() const { return barriers_; }  ///< the number of barriers so far
  uint32_t dispatches() const { return dispatches_; }
  VkCommandBuffer commands() const { return commands_; }  ///< the command buffer of the next command

 private:
  void require(Stage stage, std::span<const Use> uses);
  void dispatch_groups(const Kernel& kernel, VkDescriptorSet set, std::span<const std::byte> push, Groups first, Groups count);

  const Context& context_;
  VkCommandBuffer commands_;
  Submission* submission_ = nullptr;  // null: a command buffer of the application, which must keep it short enough
  uint64_t groups_ = 0;               // recorded in commands_ so far
  DescriptorArena& arena_;
  StageTimer* timer_;
  std::unique_ptr<HazardTracker> hazards_;
  VkPipeline bound_ = VK_NULL_HANDLE;
  std::vector<Use> uses_;  // a member, to keep its capacity
  uint32_t barriers_ = 0, dispatches_ = 0;
  bool compile_only_ = false;
};

}  // namespace iclk::engine
