#pragma once
#include <memory>

#include <vulkan/vulkan_core.h>

namespace iclk::engine {

/// The Vulkan loader of this machine, opened at run time. Programs therefore start without one, and their CPU solver works.
class Loader {
 public:
  /// Throws Error(no_driver) if libvulkan.so.1, or its equivalent on this system, cannot be opened.
  Loader();
  PFN_vkGetInstanceProcAddr get_instance_proc_addr() const { return get_; }

 private:
  std::shared_ptr<void> library_;
  PFN_vkGetInstanceProcAddr get_ = nullptr;
};

}  // namespace iclk::engine
