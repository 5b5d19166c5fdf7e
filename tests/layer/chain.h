#pragma once
// The way down: what the layer calls below itself, for every instance and device.
#include <map>
#include <memory>
#include <mutex>
#include <set>

#include <iclk/engine/vulkan_functions.h>

namespace iclk::test {

struct InstanceBelow {
  VkInstance handle = VK_NULL_HANDLE;
  PFN_vkGetInstanceProcAddr get = nullptr;
  PFN_vkDestroyInstance DestroyInstance = nullptr;
  PFN_vkEnumeratePhysicalDevices EnumeratePhysicalDevices = nullptr;
  PFN_vkEnumerateDeviceExtensionProperties EnumerateDeviceExtensionProperties = nullptr;
  PFN_vkCreateDevice CreateDevice = nullptr;
  PFN_vkCreateDebugUtilsMessengerEXT CreateDebugUtilsMessengerEXT = nullptr;    // null without its extension
  PFN_vkDestroyDebugUtilsMessengerEXT DestroyDebugUtilsMessengerEXT = nullptr;  // the same

  static constexpr bool may_be_lost = false;
};

struct DeviceBelow : engine::DeviceFunctions {
  VkDevice handle = VK_NULL_HANDLE;
  PFN_vkGetDeviceProcAddr get = nullptr;

  static constexpr bool may_be_lost = true;
  std::mutex mutex;  // of what follows
  bool lost = false;
  std::set<VkFence> pending;  // submitted and not waited for
};

/// By the loader's dispatch pointer, which a device shares with its queues and command buffers, an instance with its physical
/// devices.
template <class Below>
class Chain {
 public:
  std::shared_ptr<Below> add(const void* handle) {
    const std::lock_guard lock(mutex_);
    return below_[key(handle)] = std::make_shared<Below>();
  }
  std::shared_ptr<Below> of(const void* handle) const {
    const std::lock_guard lock(mutex_);
    return below_.at(key(handle));
  }
  void remove(const void* handle) {
    const std::lock_guard lock(mutex_);
    below_.erase(key(handle));
  }

 private:
  static const void* key(const void* handle) { return *static_cast<const void* const*>(handle); }
  mutable std::mutex mutex_;
  std::map<const void*, std::shared_ptr<Below>> below_;
};

}  // namespace iclk::test
