#pragma once
// iclk calls Vulkan functions only through these tables. It therefore does not link against libvulkan. An application may
// include its own Vulkan headers with or without prototypes, before or after this one.
#include <vulkan/vulkan_core.h>

namespace iclk::engine {

// The lists of all Vulkan functions that the library calls.
#define ICLK_INSTANCE_FUNCTIONS(X)          \
  X(DestroyInstance)                        \
  X(EnumeratePhysicalDevices)               \
  X(EnumerateDeviceExtensionProperties)     \
  X(GetPhysicalDeviceFeatures)              \
  X(GetPhysicalDeviceProperties)            \
  X(GetPhysicalDeviceProperties2)           \
  X(GetPhysicalDeviceMemoryProperties)      \
  X(GetPhysicalDeviceQueueFamilyProperties) \
  X(GetPhysicalDeviceFormatProperties)      \
  X(CreateDevice)                           \
  X(GetDeviceProcAddr)

#define ICLK_DEVICE_FUNCTIONS(X) \
  X(DestroyDevice)               \
  X(GetDeviceQueue)              \
  X(DeviceWaitIdle)              \
  X(QueueSubmit)                 \
  X(AllocateMemory)              \
  X(FreeMemory)                  \
  X(MapMemory)                   \
  X(CreateBuffer)                \
  X(DestroyBuffer)               \
  X(GetBufferMemoryRequirements) \
  X(BindBufferMemory)            \
  X(CreateBufferView)            \
  X(DestroyBufferView)           \
  X(CreateShaderModule)          \
  X(DestroyShaderModule)         \
  X(CreatePipelineCache)         \
  X(DestroyPipelineCache)        \
  X(GetPipelineCacheData)        \
  X(CreateComputePipelines)      \
  X(DestroyPipeline)             \
  X(CreatePipelineLayout)        \
  X(DestroyPipelineLayout)       \
  X(CreateDescriptorSetLayout)   \
  X(DestroyDescriptorSetLayout)  \
  X(CreateDescriptorPool)        \
  X(DestroyDescriptorPool)       \
  X(ResetDescriptorPool)         \
  X(AllocateDescriptorSets)      \
  X(UpdateDescriptorSets)        \
  X(CreateCommandPool)           \
  X(DestroyCommandPool)          \
  X(ResetCommandPool)            \
  X(AllocateCommandBuffers)      \
  X(BeginCommandBuffer)          \
  X(EndCommandBuffer)            \
  X(CmdBindPipeline)             \
  X(CmdBindDescriptorSets)       \
  X(CmdPushConstants)            \
  X(CmdDispatch)                 \
  X(CmdDispatchBase)             \
  X(CmdCopyBuffer)               \
  X(CmdFillBuffer)               \
  X(CmdCopyImageToBuffer)        \
  X(CmdPipelineBarrier)          \
  X(CmdResetQueryPool)           \
  X(CmdWriteTimestamp)           \
  X(CreateFence)                 \
  X(DestroyFence)                \
  X(ResetFences)                 \
  X(WaitForFences)               \
  X(CreateQueryPool)             \
  X(DestroyQueryPool)            \
  X(GetQueryPoolResults)

/// Functions of an instance: `EnumeratePhysicalDevices` is vkEnumeratePhysicalDevices.
struct InstanceFunctions {
#define X(name) PFN_vk##name name = nullptr;
  ICLK_INSTANCE_FUNCTIONS(X)
#undef X
};

/// Functions of a device, called without the dispatch of the loader.
struct DeviceFunctions {
#define X(name) PFN_vk##name name = nullptr;
  ICLK_DEVICE_FUNCTIONS(X)
#undef X
};

/// Throws Error(unsupported) that names a missing function.
InstanceFunctions load_instance_functions(PFN_vkGetInstanceProcAddr get, VkInstance instance);
/// Throws Error(unsupported) that names a missing function.
DeviceFunctions load_device_functions(PFN_vkGetDeviceProcAddr get, VkDevice device);

}  // namespace iclk::engine
