#include <iclk/engine/requirements.h>

#include <algorithm>

namespace iclk::engine {
namespace {

constexpr size_t feature_count = sizeof(VkPhysicalDeviceFeatures) / sizeof(VkBool32);

bool lacks_feature(const VkPhysicalDeviceFeatures& needed, const VkPhysicalDeviceFeatures& has) {
  // VkPhysicalDeviceFeatures has only VkBool32 members.
  const auto* a = reinterpret_cast<const VkBool32*>(&needed);
  const auto* b = reinterpret_cast<const VkBool32*>(&has);
  for (size_t i = 0; i < feature_count; ++i)
    if (a[i] && !b[i]) return true;
  return false;
}

}  // namespace

DeviceRequirements requirements() { return {}; }

std::string unmet(const DeviceRequirements& needed, const DeviceCapabilities& device) {
  std::string missing;
  const auto add = [&](const std::string& text) { missing += (missing.empty() ? "" : "; ") + text; };
  const auto at_least = [&](const char* limit, uint64_t has, uint64_t need) {
    if (has < need) add(std::string(limit) + " " + std::to_string(has) + ", needs " + std::to_string(need));
  };
  if (device.api_version < needed.api_version)
    add("Vulkan " + version_text(device.api_version) + ", needs " + version_text(needed.api_version));
  for (const std::string& extension : needed.device_extensions)
    if (std::find(device.device_extensions.begin(), device.device_extensions.end(), extension) ==
        device.device_extensions.end())
      add("no " + extension);
  if (lacks_feature(needed.features, device.features)) add("a core feature is missing");
  if (choose_queue_family(device.queue_families, needed.queue_flags) < 0) add("no queue family with compute");
  at_least("maxPerStageDescriptorStorageBuffers", device.limits.maxPerStageDescriptorStorageBuffers,
           device.limits.maxTexelBufferElements < kLeastTexels ? needed.max_storage_buffers_without_texels
                                                               : needed.max_storage_buffers);
  at_least("maxPushConstantsSize", device.limits.maxPushConstantsSize, needed.max_push_constants_size);
  at_least("maxComputeWorkGroupInvocations", device.limits.maxComputeWorkGroupInvocations, needed.max_workgroup_invocations);
  at_least("maxComputeSharedMemorySize", device.limits.maxComputeSharedMemorySize, needed.max_shared_memory);
  return missing;
}

int choose_queue_family(const std::vector<VkQueueFamilyProperties>& families, VkQueueFlags flags) {
  int chosen = -1;
  for (int i = 0; i < static_cast<int>(families.size()); ++i) {
    const VkQueueFamilyProperties& family = families[i];
    if (family.queueCount == 0 || (family.queueFlags & flags) != flags) continue;
    if (!(family.queueFlags & VK_QUEUE_GRAPHICS_BIT)) return i;
    if (chosen < 0) chosen = i;
  }
  return chosen;
}

std::vector<std::string> extensions_to_enable(const DeviceRequirements& needed, const DeviceCapabilities& device) {
  constexpr const char* portability_subset = "VK_KHR_portability_subset";
  std::vector<std::string> extensions = needed.device_extensions;
  const auto& offered = device.device_extensions;
  if (std::find(offered.begin(), offered.end(), portability_subset) != offered.end()) extensions.push_back(portability_subset);
  return extensions;
}

std::string version_text(uint32_t version) {
  return std::to_string(VK_API_VERSION_MAJOR(version)) + "." + std::to_string(VK_API_VERSION_MINOR(version)) + "." +
         std::to_string(VK_API_VERSION_PATCH(version));
}

}  // namespace iclk::engine
