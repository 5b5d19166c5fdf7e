#pragma once
// The pipelines of a context. Its aligners, refiners and searches need equal pipelines, and a driver may take a tenth of a
// second for each. The context therefore makes one pipeline for equal descriptions and keeps it.
#include <map>
#include <mutex>

#include <iclk/engine/compute/kernel.h>

namespace iclk::engine {

/// Thread-safe. Its pipelines live as long as the context.
class Pipelines {
 public:
  Pipelines() = default;
  Pipelines(const Pipelines&) = delete;
  Pipelines& operator=(const Pipelines&) = delete;

  /// Returns the pipeline of an equal description, or makes it. Threads that need the same pipeline at the same time may each
  /// make it; one is kept. Precondition: `description` is checked, and texel_read is storage_read if
  /// `context.storage_reads()`. Throws Error(vulkan) naming the kernel; then nothing is kept.
  Pipeline of(const Context& context, const KernelDescription& description);

  /// Must be called before the device is destroyed.
  void destroy(const DeviceFunctions& vk, VkDevice device) noexcept;

 private:
  // Code is identified by address, length and hash, because other code may later lie at the same address.
  struct Key {
    std::string name;
    const uint32_t* words;
    size_t count, hash;
    std::vector<BindingKind> bindings;
    uint32_t push_constant_bytes;
    std::vector<uint32_t> specialization;
    auto operator<=>(const Key&) const = default;
  };
  std::mutex mutex_;
  std::map<Key, Pipeline> made_;
};

}  // namespace iclk::engine
