// A Vulkan layer that makes the device below look like another: ICLK_TEST_DEVICE names a profile. It stands below the
// validation layer, which then holds iclk to the limits that are shown here. What that layer has no eye for is an abort:
//   - memory that is mapped must be host-visible and coherent, since iclk neither flushes nor invalidates;
//   - VK_KHR_portability_subset must be enabled where it is offered;
//   - workgroups must not have more invocations than the device.
// Shaders of profiles that say so compute as GPUs do (arithmetic.h).
// Buffers get the profile's alignment and a size to match, so that places that were computed wrongly overlap.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <mutex>
#include <type_traits>
#include <vector>

#include <vulkan/vk_layer.h>

#include "arithmetic.h"
#include "chain.h"
#include "profiles.h"

namespace iclk::test {
namespace {

constexpr const char* kPortabilitySubset = "VK_KHR_portability_subset";

[[noreturn]] void misuse(const char* what) {
  std::fprintf(stderr, "VK_LAYER_ICLK_device: %s\n", what);
  std::abort();
}

const Profile& shown() {
  static const Profile& chosen = [&]() -> const Profile& {
    const char* name = std::getenv("ICLK_TEST_DEVICE");
    const Profile* found = profile(name ? name : "");
    if (!found) misuse("ICLK_TEST_DEVICE names no profile");
    return *found;
  }();
  return chosen;
}

/// Functions below are asked for once, when the instance is made: later the loader answers with those on top, which lead back.
struct FakedInstance {
  VkInstance handle = VK_NULL_HANDLE;
  PFN_vkGetInstanceProcAddr get = nullptr;
  PFN_vkDestroyInstance destroy = nullptr;
  PFN_vkGetPhysicalDeviceProperties properties = nullptr;
  PFN_vkGetPhysicalDeviceProperties2 properties2 = nullptr;
  PFN_vkGetPhysicalDeviceQueueFamilyProperties queues = nullptr;
  PFN_vkEnumerateDeviceExtensionProperties extensions = nullptr;
  PFN_vkCreateDevice create_device = nullptr;
};

struct FakedDevice {
  VkDevice handle = VK_NULL_HANDLE;
  PFN_vkGetDeviceProcAddr get = nullptr;
  std::mutex mutex;
  std::map<VkDeviceMemory, uint32_t> types;  // as the application chose them
  template <class Function>
  Function function(const char* name) const {
    return reinterpret_cast<Function>(get(handle, name));
  }
};

Chain<FakedInstance>& instances() {
  static auto* const all = new Chain<FakedInstance>;
  return *all;
}
Chain<FakedDevice>& devices() {
  static auto* const all = new Chain<FakedDevice>;
  return *all;
}

void fake(VkPhysicalDeviceProperties& p) {
  const Profile& s = shown();
  // Not above what the device below can do.
  const auto at_most = [](auto& limit, auto value) { limit = std::min<std::decay_t<decltype(limit)>>(limit, value); };
  const auto at_least = [](auto& limit, auto value) { limit = std::max<std::decay_t<decltype(limit)>>(limit, value); };
  std::snprintf(p.deviceName, sizeof p.deviceName, "%s (shown by a test)", s.name);
  p.deviceType = s.type;
  p.vendorID = s.vendor;
  at_most(p.apiVersion, s.api_version);
  VkPhysicalDeviceLimits& l = p.limits;
  at_most(l.maxTexelBufferElements, s.texel_elements);
  at_most(l.maxStorageBufferRange, static_cast<uint32_t>(std::min<uint64_t>(s.storage_range, UINT32_MAX)));
  at_most(l.maxPushConstantsSize, s.push_constants);
  at_most(l.maxPerStageDescriptorStorageBuffers, s.storage_buffers);
  at_most(l.maxDescriptorSetStorageBuffers, s.storage_buffers);
  at_most(l.maxComputeSharedMemorySize, s.shared_memory);
  at_most(l.maxComputeWorkGroupInvocations, s.invocations);
  for (uint32_t& count : l.maxComputeWorkGroupCount) at_most(count, 65535u);
  at_most(l.maxComputeWorkGroupSize[0], s.invocations);
  at_most(l.maxComputeWorkGroupSize[1], s.invocations);
  at_most(l.maxComputeWorkGroupSize[2], 64u);
  at_most(l.maxMemoryAllocationCount, 4096u);
  at_least(l.minStorageBufferOffsetAlignment, s.storage_alignment);
  at_least(l.minTexelBufferOffsetAlignment, s.texel_alignment);
  at_least(l.minUniformBufferOffsetAlignment, 256u);
  at_least(l.nonCoherentAtomSize, s.atom);
  if (!s.timestamps) l.timestampComputeAndGraphics = VK_FALSE;
}

VKAPI_ATTR void VKAPI_CALL get_properties(VkPhysicalDevice physical, VkPhysicalDeviceProperties* properties) {
  instances().of(physical)->properties(physical, properties);
  fake(*properties);
}

VKAPI_ATTR void VKAPI_CALL get_properties2(VkPhysicalDevice physical, VkPhysicalDeviceProperties2* properties) {
  const Profile& s = shown();
  instances().of(physical)->properties2(physical, properties);
  fake(properties->properties);
  for (auto* next = static_cast<VkBaseOutStructure*>(properties->pNext); next; next = next->pNext) {
    if (next->sType == VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_PROPERTIES) {
      reinterpret_cast<VkPhysicalDeviceSubgroupProperties*>(next)->supportedOperations &= s.subgroup;
    } else if (next->sType == VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MAINTENANCE_3_PROPERTIES) {
      auto& most = reinterpret_cast<VkPhysicalDeviceMaintenance3Properties*>(next)->maxMemoryAllocationSize;
      most = std::min<VkDeviceSize>(most, s.allocation);
    } else if (next->sType == VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_PROPERTIES) {
      auto& both = *reinterpret_cast<VkPhysicalDeviceVulkan11Properties*>(next);
      both.subgroupSupportedOperations &= s.subgroup;
      both.maxMemoryAllocationSize = std::min<VkDeviceSize>(both.maxMemoryAllocationSize, s.allocation);
    }
  }
}

VKAPI_ATTR void VKAPI_CALL get_memory(VkPhysicalDevice, VkPhysicalDeviceMemoryProperties* memory) {
  const Profile& s = shown();
  *memory = {};
  memory->memoryTypeCount = static_cast<uint32_t>(s.types.size());
  memory->memoryHeapCount = static_cast<uint32_t>(s.heaps.size());
  std::copy(s.types.begin(), s.types.end(), memory->memoryTypes);
  std::copy(s.heaps.begin(), s.heaps.end(), memory->memoryHeaps);
}
VKAPI_ATTR void VKAPI_CALL get_memory2(VkPhysicalDevice physical, VkPhysicalDeviceMemoryProperties2* memory) {
  get_memory(physical, &memory->memoryProperties);
}

VKAPI_ATTR void VKAPI_CALL get_queues(VkPhysicalDevice physical, uint32_t* count, VkQueueFamilyProperties* families) {
  instances().of(physical)->queues(physical, count, families);
  for (uint32_t i = 0; families && !shown().timestamps && i < *count; ++i) families[i].timestampValidBits = 0;
}

VKAPI_ATTR VkResult VKAPI_CALL list_extensions(VkPhysicalDevice physical, const char* of_layer, uint32_t* count,
                                               VkExtensionProperties* out) {
  const auto below = instances().of(physical)->extensions;
  if (of_layer || !shown().portability_subset) return below(physical, of_layer, count, out);
  uint32_t there = 0;
  if (const VkResult result = below(physical, nullptr, &there, nullptr); result != VK_SUCCESS) return result;
  std::vector<VkExtensionProperties> all(there);
  if (const VkResult result = below(physical, nullptr, &there, all.data()); result != VK_SUCCESS) return result;
  VkExtensionProperties& subset = all.emplace_back();
  std::strcpy(subset.extensionName, kPortabilitySubset);
  subset.specVersion = 1;
  const auto size = static_cast<uint32_t>(all.size());
  if (!out) {
    *count = size;
    return VK_SUCCESS;
  }
  *count = std::min(*count, size);
  std::copy_n(all.begin(), *count, out);
  return *count < size ? VK_INCOMPLETE : VK_SUCCESS;
}

template <class Info>
Info* link_of(const void* next, VkStructureType type) {
  auto* info = static_cast<Info*>(const_cast<void*>(next));  // the loader's, made to be changed
  while (info && !(info->sType == type && info->function == VK_LAYER_LINK_INFO))
    info = static_cast<Info*>(const_cast<void*>(info->pNext));
  return info;
}

VKAPI_ATTR VkResult VKAPI_CALL create_instance(const VkInstanceCreateInfo* info, const VkAllocationCallbacks* allocator,
                                               VkInstance* instance) {
  auto* link = link_of<VkLayerInstanceCreateInfo>(info->pNext, VK_STRUCTURE_TYPE_LOADER_INSTANCE_CREATE_INFO);
  if (!link) return VK_ERROR_INITIALIZATION_FAILED;
  const PFN_vkGetInstanceProcAddr get = link->u.pLayerInfo->pfnNextGetInstanceProcAddr;
  link->u.pLayerInfo = link->u.pLayerInfo->pNext;
  const auto create = reinterpret_cast<PFN_vkCreateInstance>(get(nullptr, "vkCreateInstance"));
  const VkResult result = create(info, allocator, instance);
  if (result != VK_SUCCESS) return result;
  const auto below = instances().add(*instance);
  below->handle = *instance;
  below->get = get;
  const auto load = [&](auto& function, const char* name) {
    function = reinterpret_cast<std::remove_reference_t<decltype(function)>>(get(*instance, name));
  };
  load(below->destroy, "vkDestroyInstance");
  load(below->properties, "vkGetPhysicalDeviceProperties");
  load(below->properties2, "vkGetPhysicalDeviceProperties2");
  load(below->queues, "vkGetPhysicalDeviceQueueFamilyProperties");
  load(below->extensions, "vkEnumerateDeviceExtensionProperties");
  load(below->create_device, "vkCreateDevice");
  return result;
}

VKAPI_ATTR void VKAPI_CALL destroy_instance(VkInstance instance, const VkAllocationCallbacks* allocator) {
  if (!instance) return;
  const auto destroy = instances().of(instance)->destroy;
  instances().remove(instance);
  destroy(instance, allocator);
}

VKAPI_ATTR VkResult VKAPI_CALL create_device(VkPhysicalDevice physical, const VkDeviceCreateInfo* info,
                                             const VkAllocationCallbacks* allocator, VkDevice* device) {
  auto* link = link_of<VkLayerDeviceCreateInfo>(info->pNext, VK_STRUCTURE_TYPE_LOADER_DEVICE_CREATE_INFO);
  if (!link) return VK_ERROR_INITIALIZATION_FAILED;
  const PFN_vkGetDeviceProcAddr get = link->u.pLayerInfo->pfnNextGetDeviceProcAddr;
  link->u.pLayerInfo = link->u.pLayerInfo->pNext;
  VkDeviceCreateInfo below_info = *info;
  std::vector<const char*> extensions(info->ppEnabledExtensionNames,
                                      info->ppEnabledExtensionNames + info->enabledExtensionCount);
  const size_t erased = std::erase_if(extensions, [](const char* name) { return std::strcmp(name, kPortabilitySubset) == 0; });
  if (shown().portability_subset && erased == 0) misuse("VK_KHR_portability_subset is offered and was not enabled");
  below_info.enabledExtensionCount = static_cast<uint32_t>(extensions.size());
  below_info.ppEnabledExtensionNames = extensions.data();
  const VkResult result = instances().of(physical)->create_device(physical, &below_info, allocator, device);
  if (result != VK_SUCCESS) return result;
  const auto below = devices().add(*device);
  below->handle = *device;
  below->get = get;
  return result;
}

VKAPI_ATTR void VKAPI_CALL destroy_device(VkDevice device, const VkAllocationCallbacks* allocator) {
  if (!device) return;
  const auto destroy = devices().of(device)->function<PFN_vkDestroyDevice>("vkDestroyDevice");
  devices().remove(device);
  destroy(device, allocator);
}

void fake(VkMemoryRequirements& needs) {
  const Profile& s = shown();
  needs.memoryTypeBits = (1u << s.types.size()) - 1;
  needs.alignment = std::max<VkDeviceSize>({needs.alignment, s.storage_alignment, s.texel_alignment});
  needs.size = (needs.size + needs.alignment - 1) / needs.alignment * needs.alignment;
}

VKAPI_ATTR void VKAPI_CALL get_requirements(VkDevice device, VkBuffer buffer, VkMemoryRequirements* needs) {
  devices().of(device)->function<PFN_vkGetBufferMemoryRequirements>("vkGetBufferMemoryRequirements")(device, buffer, needs);
  fake(*needs);
}
VKAPI_ATTR void VKAPI_CALL get_requirements2(VkDevice device, const VkBufferMemoryRequirementsInfo2* buffer,
                                             VkMemoryRequirements2* needs) {
  devices().of(device)->function<PFN_vkGetBufferMemoryRequirements2>("vkGetBufferMemoryRequirements2")(device, buffer, needs);
  fake(needs->memoryRequirements);
}

VKAPI_ATTR VkResult VKAPI_CALL allocate(VkDevice device, const VkMemoryAllocateInfo* info,
                                        const VkAllocationCallbacks* allocator, VkDeviceMemory* memory) {
  const auto below = devices().of(device);
  const Profile& s = shown();
  if (info->memoryTypeIndex >= s.types.size()) misuse("a memory type that does not exist");
  if (info->allocationSize > s.heaps[s.types[info->memoryTypeIndex].heapIndex].size) return VK_ERROR_OUT_OF_DEVICE_MEMORY;
  VkMemoryAllocateInfo real = *info;
  real.memoryTypeIndex = 0;
  const VkResult result = below->function<PFN_vkAllocateMemory>("vkAllocateMemory")(device, &real, allocator, memory);
  if (result != VK_SUCCESS) return result;
  const std::lock_guard lock(below->mutex);
  below->types[*memory] = info->memoryTypeIndex;
  return result;
}

VKAPI_ATTR VkResult VKAPI_CALL map_memory(VkDevice device, VkDeviceMemory memory, VkDeviceSize offset, VkDeviceSize size,
                                          VkMemoryMapFlags flags, void** data) {
  const auto below = devices().of(device);
  {
    const std::lock_guard lock(below->mutex);
    const VkMemoryPropertyFlags has = shown().types[below->types.at(memory)].propertyFlags;
    if (!(has & VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT)) misuse("memory is mapped that the host does not see");
    if (!(has & VK_MEMORY_PROPERTY_HOST_COHERENT_BIT)) misuse("memory is mapped that is not coherent, and nobody flushes it");
  }
  return below->function<PFN_vkMapMemory>("vkMapMemory")(device, memory, offset, size, flags, data);
}

/// All kernels of iclk have their local size in x as specialisation constant 0; the validation layer of Debian 12 does not
/// look.
VKAPI_ATTR VkResult VKAPI_CALL create_pipelines(VkDevice device, VkPipelineCache cache, uint32_t count,
                                                const VkComputePipelineCreateInfo* infos,
                                                const VkAllocationCallbacks* allocator, VkPipeline* pipelines) {
  for (uint32_t i = 0; i < count; ++i) {
    const VkSpecializationInfo* constants = infos[i].stage.pSpecializationInfo;
    uint32_t size = 0;
    if (constants && constants->dataSize >= sizeof size) std::memcpy(&size, constants->pData, sizeof size);
    if (size > shown().invocations) misuse("a workgroup of more invocations than the device has");
  }
  return devices().of(device)->function<PFN_vkCreateComputePipelines>("vkCreateComputePipelines")(device, cache, count, infos,
                                                                                                  allocator, pipelines);
}

VKAPI_ATTR VkResult VKAPI_CALL create_module(VkDevice device, const VkShaderModuleCreateInfo* info,
                                             const VkAllocationCallbacks* allocator, VkShaderModule* module) {
  VkShaderModuleCreateInfo real = *info;
  std::vector<uint32_t> words;
  if (shown().rounds_as_gpus) {
    words = as_gpus_round({info->pCode, info->codeSize / 4});
    real.pCode = words.data();
    real.codeSize = words.size() * 4;
  }
  return devices().of(device)->function<PFN_vkCreateShaderModule>("vkCreateShaderModule")(device, &real, allocator, module);
}

struct Hook {
  const char* name;
  PFN_vkVoidFunction function;
  bool of_device;
};

PFN_vkVoidFunction hook(const char* name, bool of_device) {
#define HOOK(vulkan, ours, device) \
  { vulkan, reinterpret_cast<PFN_vkVoidFunction>(ours), device }
  static const Hook hooks[] = {
      HOOK("vkCreateInstance", create_instance, false),
      HOOK("vkDestroyInstance", destroy_instance, false),
      HOOK("vkCreateDevice", create_device, false),
      HOOK("vkGetPhysicalDeviceProperties", get_properties, false),
      HOOK("vkGetPhysicalDeviceProperties2", get_properties2, false),
      HOOK("vkGetPhysicalDeviceProperties2KHR", get_properties2, false),
      HOOK("vkGetPhysicalDeviceMemoryProperties", get_memory, false),
      HOOK("vkGetPhysicalDeviceMemoryProperties2", get_memory2, false),
      HOOK("vkGetPhysicalDeviceMemoryProperties2KHR", get_memory2, false),
      HOOK("vkGetPhysicalDeviceQueueFamilyProperties", get_queues, false),
      HOOK("vkEnumerateDeviceExtensionProperties", list_extensions, false),
      HOOK("vkDestroyDevice", destroy_device, true),
      HOOK("vkGetBufferMemoryRequirements", get_requirements, true),
      HOOK("vkGetBufferMemoryRequirements2", get_requirements2, true),
      HOOK("vkGetBufferMemoryRequirements2KHR", get_requirements2, true),
      HOOK("vkAllocateMemory", allocate, true),
      HOOK("vkMapMemory", map_memory, true),
      HOOK("vkCreateShaderModule", create_module, true),
      HOOK("vkCreateComputePipelines", create_pipelines, true),
  };
#undef HOOK
  for (const Hook& each : hooks)
    if (std::strcmp(each.name, name) == 0 && (each.of_device || !of_device)) return each.function;
  return nullptr;
}

}  // namespace
}  // namespace iclk::test

extern "C" {

VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL iclk_device_layer_get_device(VkDevice device, const char* name) {
  if (std::strcmp(name, "vkGetDeviceProcAddr") == 0) return reinterpret_cast<PFN_vkVoidFunction>(iclk_device_layer_get_device);
  if (const PFN_vkVoidFunction ours = iclk::test::hook(name, true)) return ours;
  return iclk::test::devices().of(device)->get(device, name);
}

VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL iclk_device_layer_get_instance(VkInstance instance, const char* name) {
  if (std::strcmp(name, "vkGetInstanceProcAddr") == 0)
    return reinterpret_cast<PFN_vkVoidFunction>(iclk_device_layer_get_instance);
  if (std::strcmp(name, "vkGetDeviceProcAddr") == 0) return reinterpret_cast<PFN_vkVoidFunction>(iclk_device_layer_get_device);
  const PFN_vkVoidFunction ours = iclk::test::hook(name, false);
  // Of the layer that it calls first the loader asks vkCreateInstance with an instance that is not made yet.
  if (!instance || std::strcmp(name, "vkCreateInstance") == 0) return ours;
  const PFN_vkVoidFunction below = iclk::test::instances().of(instance)->get(instance, name);
  return below && ours ? ours : below;
}
}
