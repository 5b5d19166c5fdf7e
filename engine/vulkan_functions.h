#pragma once
// Nothing in iclk calls a Vulkan function by its global name, so nothing links against libvulkan and an application may
// include its own Vulkan headers with or without prototypes, before or after this one.
#include <vulkan/vulkan_core.h>

namespace iclk::engine {

// Each function that the library calls is named once, here.
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

/// Functions of an instance. `functions.EnumeratePhysicalDevices` is vkEnumeratePhysicalDevices.
struct InstanceFunctions {
#define X(name) PFN_vk##name name = nullptr;
  ICLK_INSTANCE_FUNCTIONS(X)
#undef X
};

/// Functions of a device, without the loader's dispatch in between.
struct DeviceFunctions {
#define X(name) PFN_vk##name name = nullptr;
  ICLK_DEVICE_FUNCTIONS(X)
#undef X
};

/// Throws Error(unsupported) that names the function which the implementation lacks.
InstanceFunctions load_instance_functions(PFN_vkGetInstanceProcAddr get, VkInstance instance);
DeviceFunctions load_device_functions(PFN_vkGetDeviceProcAddr get, VkDevice device);

}  // namespace iclk::engine
