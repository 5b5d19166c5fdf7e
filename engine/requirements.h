#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include <vulkan/vulkan_core.h>

namespace iclk::engine {

/// Kernels read through texel buffers only if the device allows this many elements in one: enough for images of a few
/// megapixels. Vulkan guarantees 65,536; desktop GPUs have 2^26 and more.
inline constexpr uint32_t kLeastTexels = 1u << 24;

/// The requirements of iclk on a device. An application that creates its own device reads them first.
struct DeviceRequirements {
  uint32_t api_version = VK_API_VERSION_1_1;        ///< of the device, and VkApplicationInfo::apiVersion of the instance
  std::vector<std::string> instance_extensions;     ///< to enable; empty: none are needed
  std::vector<std::string> device_extensions;       ///< to enable; empty: none are needed
  VkPhysicalDeviceFeatures features{};              ///< to enable; all false: none are needed
  VkQueueFlags queue_flags = VK_QUEUE_COMPUTE_BIT;  ///< of the queue's family; compute implies transfer
  // Smallest limits of the device:
  uint32_t max_storage_buffers = 8;  ///< bound in one kernel
  /// The same on devices with maxTexelBufferElements below kLeastTexels, where storage buffers replace texel buffers.
  uint32_t max_storage_buffers_without_texels = 11;
  uint32_t max_push_constants_size = 128;  ///< bytes
  uint32_t max_workgroup_invocations = 128;
  uint32_t max_shared_memory = 16384;  ///< bytes of a workgroup
};

DeviceRequirements requirements();

/// The properties of a device that are compared with DeviceRequirements.
struct DeviceCapabilities {
  uint32_t api_version = 0;
  std::vector<std::string> device_extensions;
  VkPhysicalDeviceFeatures features{};
  VkPhysicalDeviceLimits limits{};
  std::vector<VkQueueFamilyProperties> queue_families;
};

/// Lists the missing requirements, for example "Vulkan 1.0.3, needs 1.1; no queue family with COMPUTE". Empty: none.
std::string unmet(const DeviceRequirements& needed, const DeviceCapabilities& device);

/// The extensions to enable on a new device: those of `needed`, and VK_KHR_portability_subset if the device offers it, as the
/// Vulkan specification requires.
std::vector<std::string> extensions_to_enable(const DeviceRequirements& needed, const DeviceCapabilities& device);

/// Chooses a queue family: the first that has `flags` but no graphics, so that it runs beside rendering; else the first that
/// has `flags`. Returns -1 if there is none.
int choose_queue_family(const std::vector<VkQueueFamilyProperties>& families, VkQueueFlags flags);

/// Formats a packed version, for example "1.3.230".
std::string version_text(uint32_t version);

}  // namespace iclk::engine
