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

/// Workgroups of a dispatch.
struct Groups {
  uint32_t x = 1, y = 1, z = 1;
};

/// Workgroups of `size` invocations that cover `count`.
constexpr uint32_t groups_for(uint32_t count, uint32_t size) { return count / size + (count % size != 0); }

/// Writes commands into a command buffer, ours or the application's, and places the barriers that they need: global memory
/// barriers of the COMPUTE, TRANSFER and HOST stages only, none where none is needed. Buffers are told apart by their VkBuffer.
///
/// Before its first command a recording waits once for all earlier compute and transfer work on the queue. Whatever else the
/// application did with a buffer or an image (graphics, host writes after the submission) it must have ordered itself.
///
/// Nothing is submitted. The command buffer must be in the recording state; kernels, buffers, arena and timer must live
/// until it has executed for the last time. One thread at a time.
class Recorder {
 public:
  Recorder(const Context& context, VkCommandBuffer commands, DescriptorArena& arena, StageTimer* timer = nullptr);
  /// Begins `submission` and records into it. What would keep a watched device for too long goes on in its next command buffer,
  /// within a dispatch too. `submission` must live as long.
  Recorder(Submission& submission, DescriptorArena& arena, StageTimer* timer = nullptr);
  ~Recorder();  ///< records nothing
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;

  /// From here on dispatches run no workgroup. Drivers that compile a kernel when it first runs, as lavapipe does, then compile
  /// it without computing.
  void compile_only() { compile_only_ = true; }

  /// Names the commands that follow, for the timer.
  void stage(const char* name);

  /// Binds buffers[i] to binding i, pushes `push` (exactly Kernel::push_constant_bytes()) and dispatches. No groups: no
  /// command. Throws Error(invalid_argument) for a mismatch, Error(unsupported) beyond maxComputeWorkGroupCount.
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
  /// The first `bytes` bytes.
  void copy(const Buffer& source, const Buffer& destination, VkDeviceSize bytes) {
    const VkBufferCopy region{0, 0, bytes};
    copy(source, destination, std::span(&region, 1));
  }
  /// Bytes that the host has written into a MemoryKind::table, or will have before the submission. Nothing where it is mapped.
  void upload(const Buffer& table, VkDeviceSize offset, VkDeviceSize bytes);
  /// Sets 32-bit words. `offset` and `bytes` are multiples of 4; VK_WHOLE_SIZE: to the end.
  void fill(const Buffer& buffer, uint32_t word = 0, VkDeviceSize offset = 0, VkDeviceSize bytes = VK_WHOLE_SIZE);

  /// Copies mip level 0 of layer 0, `row_texels` texels from a row to the next (0: rows are packed), to byte `offset`.
  /// Throws Error(invalid_argument) for an undefined layout, a format that is not an uncompressed colour of 1 to 16 bytes
  /// (format.h), a null handle, an empty image, or a destination that is too small.
  void copy_image_to_buffer(const ForeignImage& image, const Buffer& destination, VkDeviceSize offset = 0,
                            uint32_t row_texels = 0);

  /// Makes what was written visible to the host once the fence of the submission is signalled. Call it last.
  void host_read(std::span<const Buffer* const> buffers);
  void host_read(std::initializer_list<const Buffer*> buffers) { host_read(std::span(buffers.begin(), buffers.size())); }

  /// Makes what was written visible to compute and transfer commands that others record after this.
  void publish(std::span<const Buffer* const> buffers);
  void publish(std::initializer_list<const Buffer*> buffers) { publish(std::span(buffers.begin(), buffers.size())); }

  /// Ends the last stage of the timer. Does not end the command buffer.
  void finish();

  uint32_t barriers() const { return barriers_; }  ///< placed so far
  uint32_t dispatches() const { return dispatches_; }
  VkCommandBuffer commands() const { return commands_; }  ///< those that the next command goes to

 private:
  void require(Stage stage, std::span<const Use> uses);
  void dispatch_groups(const Kernel& kernel, VkDescriptorSet set, std::span<const std::byte> push, Groups first, Groups count);

  const Context& context_;
  VkCommandBuffer commands_;
  Submission* submission_ = nullptr;  // null: the application's command buffer, where it answers for the time
  uint64_t groups_ = 0;               // in commands_ so far
  DescriptorArena& arena_;
  StageTimer* timer_;
  std::unique_ptr<HazardTracker> hazards_;
  VkPipeline bound_ = VK_NULL_HANDLE;
  std::vector<Use> uses_;  // kept for its capacity
  uint32_t barriers_ = 0, dispatches_ = 0;
  bool compile_only_ = false;
};

}  // namespace iclk::engine
