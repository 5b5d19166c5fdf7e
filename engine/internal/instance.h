#pragma once
// The instance, its validation and queries of physical devices.
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <iclk/engine/context.h>
#include <iclk/engine/internal/loader.h>

namespace iclk::engine {

/// Receives messages of the validation layer. Vulkan keeps a pointer to it, so it must not move.
struct Validation {
  std::function<void(MessageSeverity, const std::string&)> on_message;
  std::mutex mutex;
  VkDebugUtilsMessengerEXT messenger = VK_NULL_HANDLE;
};

/// A VkInstance of iclk with its messenger; the destructor destroys both.
class Instance {
 public:
  Instance(bool validation, std::function<void(MessageSeverity, const std::string&)> on_message);
  ~Instance();
  Instance(const Instance&) = delete;
  Instance& operator=(const Instance&) = delete;

  VkInstance handle() const { return handle_; }
  const InstanceFunctions& functions() const { return functions_; }
  PFN_vkGetInstanceProcAddr get_instance_proc_addr() const { return loader_.get_instance_proc_addr(); }
  bool validation() const { return validation_ != nullptr; }
  std::vector<VkPhysicalDevice> physical_devices() const;

 private:
  Loader loader_;
  std::unique_ptr<Validation> validation_;
  VkInstance handle_ = VK_NULL_HANDLE;
  InstanceFunctions functions_;
};

DeviceCapabilities capabilities_of(const InstanceFunctions& vk, VkPhysicalDevice device);
DeviceInfo info_of(const InstanceFunctions& vk, VkPhysicalDevice device, const DeviceCapabilities& capabilities);

}  // namespace iclk::engine
