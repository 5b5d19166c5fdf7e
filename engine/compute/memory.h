#pragma once
#include <array>
#include <memory>
#include <string>
#include <vector>

#include <iclk/engine/context.h>
#include <iclk/engine/resources.h>

namespace iclk::engine {

enum class MemoryKind : uint32_t {
  device,    ///< device local; mapped as well where device memory is host memory (Context::unified_memory)
  upload,    ///< host-visible and coherent, for writing in order; reading it may be very slow
  readback,  ///< host-visible and coherent, cached where the device offers it
  /// Device local, written by the host: mapped where device memory is host memory, else with a twin of the kind upload, which
  /// is what is mapped, and which Recorder::upload() copies.
  table,
};
const char* name(MemoryKind kind);

/// What kernels do with a buffer. Every buffer can be the source and the destination of copies and fills besides.
enum class BufferUse : uint32_t { transfer = 0, storage = 1, texel = 2, uniform = 4, image = 8 };
constexpr BufferUse operator|(BufferUse a, BufferUse b) { return static_cast<BufferUse>(uint32_t(a) | uint32_t(b)); }
constexpr bool has(BufferUse uses, BufferUse one) { return (uint32_t(uses) & uint32_t(one)) != 0; }

struct BufferDescription {
  std::string name;        ///< for messages and debuggers
  VkDeviceSize bytes = 0;  ///< > 0; rounded up to a multiple of 16
  MemoryKind kind = MemoryKind::device;
  BufferUse use = BufferUse::storage;
  /// Where Context::storage_reads(), texel and image are storage. With BufferUse::texel or image: the format in which
  /// texel_read and image_read bindings see the whole buffer. R32_SFLOAT, R32G32B32A32_SFLOAT, R8G8B8A8_UNORM and R32_UINT
  /// exist on every device; R8_UNORM and B8G8R8A8_UNORM do as texel.
  VkFormat texel_format = VK_FORMAT_UNDEFINED;
};

/// Names a buffer of a plan and of every workspace made from it.
enum class BufferId : uint32_t {};

/// A list of buffers; allocates nothing.
class MemoryPlan {
 public:
  /// Throws Error(invalid_argument) for zero bytes or a texel buffer without a format.
  BufferId add(BufferDescription description);
  BufferId add(std::string name, VkDeviceSize bytes, MemoryKind kind, BufferUse use,
               VkFormat texel_format = VK_FORMAT_UNDEFINED) {
    return add({std::move(name), bytes, kind, use, texel_format});
  }
  const std::vector<BufferDescription>& buffers() const { return buffers_; }

  /// Exactly what a Workspace of this plan allocates on that device.
  /// Throws Error(unsupported) for what the device cannot hold: see Workspace.
  MemoryBytes bytes(const Context& context) const;

 private:
  std::vector<BufferDescription> buffers_;
};

/// The buffers of a plan in as few allocations as the device permits: one a kind, unless it exceeds Context::max_allocation().
/// Contents are undefined at first. Move only. Must outlive the device's work on it.
class Workspace {
 public:
  Workspace() = default;
  /// Throws Error(unsupported), naming buffer, bytes and limit, for a buffer beyond maxStorageBufferRange,
  /// maxUniformBufferRange, maxTexelBufferElements or one allocation, and for a plan beyond a memory heap;
  /// Error(out_of_memory) with the bytes asked for.
  Workspace(std::shared_ptr<const Context> context, const MemoryPlan& plan);
  ~Workspace();
  Workspace(Workspace&& other) noexcept;
  Workspace& operator=(Workspace&& other) noexcept;

  const Buffer& operator[](BufferId id) const { return buffers_[static_cast<size_t>(id)]; }
  const MemoryBytes& bytes() const { return bytes_; }

 private:
  void destroy() noexcept;

  std::shared_ptr<const Context> context_;
  std::vector<Buffer> buffers_;
  std::vector<MemoryBlock> memory_;
  MemoryBytes bytes_;
};

}  // namespace iclk::engine
