#pragma once
// The Vulkan objects of kernels. Aligners, refiners and searches of a context want the same ones again and again, and a driver
// may take a tenth of a second for each: a context makes those of equal descriptions once, and keeps them.
#include <map>
#include <mutex>

#include <iclk/engine/compute/kernel.h>

namespace iclk::engine {

/// Thread-safe. What it holds lives as long as the context.
class Pipelines {
 public:
  Pipelines() = default;
  Pipelines(const Pipelines&) = delete;
  Pipelines& operator=(const Pipelines&) = delete;

  /// The one of an equal description, or a new one; threads that ask for the same at the same time may each make it, and one
  /// is kept. `description` is checked, and reads as `context` does. Throws Error(vulkan) naming the kernel; then nothing is
  /// kept.
  Pipeline of(const Context& context, const KernelDescription& description);

  /// Before the device goes.
  void destroy(const DeviceFunctions& vk, VkDevice device) noexcept;

 private:
  // Code by its place, length and hash: what is read later at the same place may be other code.
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
