#pragma once
#include <array>
#include <memory>
#include <string>
#include <vector>

#include <iclk/engine/context.h>
#include <iclk/engine/resources.h>

namespace iclk::engine {

enum class MemoryKind : uint32_t {
  device,    ///< device local; mapped if Context::unified_memory()
  upload,    ///< host-visible and coherent, for sequential writes; reads may be very slow
  readback,  ///< host-visible and coherent, cached if the device offers it
  /// Device local and written by the host. It is mapped if Context::unified_memory(). Else `mapped` belongs to a twin of kind
  /// upload, which Recorder::upload() copies to this buffer.
  table,
};
const char* name(MemoryKind kind);

/// How kernels use a buffer. Copies and fills may use every buffer.
enum class BufferUse : uint32_t { transfer = 0, storage = 1, texel = 2, uniform = 4, image = 8 };
constexpr BufferUse operator|(BufferUse a, BufferUse b) { return static_cast<BufferUse>(uint32_t(a) | uint32_t(b)); }
constexpr bool has(BufferUse uses, BufferUse one) { return (uint32_t(uses) & uint32_t(one)) != 0; }

struct BufferDescription {
  std::string name;        ///< for messages and debuggers
  VkDeviceSize bytes = 0;  ///< > 0; rounded up to a multiple of 16
  MemoryKind kind = MemoryKind::device;
  BufferUse use = BufferUse::storage;
  /// With BufferUse::texel or image: the format in which texel_read and image_read bindings read the whole buffer. Every device
  /// supports R32_SFLOAT, R32G32B32A32_SFLOAT, R8G8B8A8_UNORM and R32_UINT. For texel, it also supports R8_UNORM and
  /// B8G8R8A8_UNORM. If Context::storage_reads(), texel and image are storage.
  VkFormat texel_format = VK_FORMAT_UNDEFINED;
};

/// Identifies a buffer in a plan and in every workspace of that plan.
enum class BufferId : uint32_t {};

/// A list of buffers. It allocates no device memory.
class MemoryPlan {
 public:
  /// Throws Error(invalid_argument) for zero bytes or a texel buffer without a format.
  BufferId add(BufferDescription description);
  BufferId add(std::string name, VkDeviceSize bytes, MemoryKind kind, BufferUse use,
               VkFormat texel_format = VK_FORMAT_UNDEFINED) {
    return add({std::move(name), bytes, kind, use, texel_format});
  }
  const std::vector<BufferDescription>& buffers() const { return buffers_; }

  /// The exact number of bytes that a Workspace of this plan allocates on this device.
  /// Throws Error(unsupported) if the plan exceeds a limit of the device: see Workspace.
  MemoryBytes bytes(const Context& context) const;

 private:
  std::vector<BufferDescription> buffers_;
};

/// The buffers of a plan in as few allocations as the device permits: one per kind, or several if it exceeds
/// Context::max_allocation(). Contents are undefined at first. Move only. Must outlive the device's work on it.
class Workspace {
 public:
  Workspace() = default;
  /// Throws Error(unsupported) for a buffer beyond maxStorageBufferRange, maxUniformBufferRange, maxTexelBufferElements or one
  /// allocation, and for a plan beyond a memory heap; it names the buffer, its bytes and the limit. Throws
  /// Error(out_of_memory) with the requested bytes.
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
