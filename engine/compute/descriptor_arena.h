#pragma once
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <vector>

#include <iclk/engine/compute/kernel.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/engine/context.h>

namespace iclk::engine {

/// The largest number of descriptors that a recording needs, by kind.
struct ArenaSize {
  uint32_t sets = 0, storage = 0, texel = 0, uniform = 0, image = 0, sampled = 0;
  /// Room for `count` different sets of buffers bound to a kernel.
  void add(const Kernel& kernel, uint32_t count = 1);
};

/// The descriptor sets of one recording. The arena must live, without reset(), as long as the command buffer may be executed.
/// Every recording into a command buffer of the application therefore owns one. Equal buffers bound to the same kernel share
/// one set. One thread at a time.
class DescriptorArena {
 public:
  DescriptorArena(std::shared_ptr<const Context> context, const ArenaSize& size);
  ~DescriptorArena();
  DescriptorArena(const DescriptorArena&) = delete;
  DescriptorArena& operator=(const DescriptorArena&) = delete;

  /// Returns a set that binds the whole of buffers[i] to binding i. Throws Error(invalid_argument) for a wrong number of
  /// buffers, a null buffer, a texel binding without a view, or a full arena. Throws Error(unsupported) for a buffer beyond
  /// maxStorageBufferRange.
  VkDescriptorSet set(const Kernel& kernel, std::span<const Buffer* const> buffers);

  /// Frees every set. Precondition: no command buffer that uses them is pending or will be submitted again.
  void reset();

  uint32_t used() const { return static_cast<uint32_t>(sets_.size()); }

 private:
  std::shared_ptr<const Context> context_;
  ArenaSize size_, used_;
  VkDescriptorPool pool_ = VK_NULL_HANDLE;
  std::map<std::vector<uint64_t>, VkDescriptorSet> sets_;  // by set layout and handles
};

}  // namespace iclk::engine
