#pragma once
// What a test sees of the Vulkan layer in this folder: it opens the module with dlopen() and asks for `iclk_test_layer`.
#include <cstdint>
#include <string>
#include <vector>

#include <vulkan/vulkan_core.h>

namespace iclk::test {

/// A Vulkan function that can fail, and the results by which the specification lets it.
struct LayerCall {
  std::string name;  ///< "vkAllocateMemory"
  std::vector<VkResult> results;
};

/// Handles made and not destroyed, of all instances and devices of the process that see the layer.
struct LiveObjects {
  uint64_t handles = 0;
  uint64_t device_bytes = 0;  ///< of vkAllocateMemory
  std::string names;          ///< "2 VkBuffer, 1 VkFence", for messages
  bool operator==(const LiveObjects&) const = default;
};

/// Thread-safe, but for arm() while calls are under way.
class LayerControl {
 public:
  virtual ~LayerControl() = default;
  /// All calls that the layer can let fail.
  virtual const std::vector<LayerCall>& calls() const = 0;

  /// Counts calls from zero again; from the `ordinal`-th (from 0) on, `times` calls of `call` fail with `result` and are not
  /// handed down. What they should have written is undefined, as the specification says: handles are garbage. After
  /// VK_ERROR_DEVICE_LOST the device has executed all it ever will, and every call on it that may return that result does.
  virtual void arm(const std::string& call, uint32_t ordinal, VkResult result, uint32_t times = 1) = 0;
  /// Counts from zero again; nothing fails but calls on devices that are lost already.
  virtual void disarm() = 0;
  /// Whether the armed fault came.
  virtual bool fired() const = 0;
  virtual uint32_t count(const std::string& call) const = 0;

  virtual LiveObjects live() const = 0;
  /// Wrong use since the last call of this function, a sentence each: handles destroyed that are none, a fence or a device
  /// destroyed while a submission is pending.
  virtual std::vector<std::string> take_misuse() = 0;
};

using GetLayerControl = LayerControl* (*)();

}  // namespace iclk::test
