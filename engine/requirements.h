#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include <vulkan/vulkan_core.h>

namespace iclk::engine {

/// Elements of a texel buffer with which images of a few megapixels can be read through one. Vulkan promises 65,536; desktop
/// GPUs have 2^26 and more.
inline constexpr uint32_t kLeastTexels = 1u << 24;

/// What a device must bring, as data: an application that creates the device itself reads it before it does.
struct DeviceRequirements {
  uint32_t api_version = VK_API_VERSION_1_1;        ///< of the device, and VkApplicationInfo::apiVersion of the instance
  std::vector<std::string> instance_extensions;     ///< to enable: none
  std::vector<std::string> device_extensions;       ///< to enable: none
  VkPhysicalDeviceFeatures features{};              ///< to enable: none
  VkQueueFlags queue_flags = VK_QUEUE_COMPUTE_BIT;  ///< of the queue's family; transfers are implied by compute
  // Limits, at least:
  uint32_t max_storage_buffers = 8;  ///< bound in one kernel
  /// The same where maxTexelBufferElements is below kLeastTexels, and storage buffers take the place of texel buffers.
  uint32_t max_storage_buffers_without_texels = 11;
  uint32_t max_push_constants_size = 128;  ///< bytes
  uint32_t max_workgroup_invocations = 128;
  uint32_t max_shared_memory = 16384;  ///< bytes of a workgroup
};

DeviceRequirements requirements();

/// What a device has, to be compared.
struct DeviceCapabilities {
  uint32_t api_version = 0;
  std::vector<std::string> device_extensions;
  VkPhysicalDeviceFeatures features{};
  VkPhysicalDeviceLimits limits{};
  std::vector<VkQueueFamilyProperties> queue_families;
};

/// What is missing, in words with numbers ("Vulkan 1.0.3, needs 1.1; no queue family with COMPUTE"); empty when nothing is.
std::string unmet(const DeviceRequirements& needed, const DeviceCapabilities& device);

/// Extensions to create a device with: those of `needed`, and VK_KHR_portability_subset, which the specification wants enabled
/// where it is offered.
std::vector<std::string> extensions_to_enable(const DeviceRequirements& needed, const DeviceCapabilities& device);

/// The family to use: the first with compute and without graphics, which runs beside rendering; else the first with the
/// flags. -1 when there is none.
int choose_queue_family(const std::vector<VkQueueFamilyProperties>& families, VkQueueFlags flags);

/// "1.3.230".
std::string version_text(uint32_t version);

}  // namespace iclk::engine
