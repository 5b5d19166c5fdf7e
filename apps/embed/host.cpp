#include "apps/embed/host.h"

#include <cstdio>
#include <cstring>
#include <vector>

#include <iclk/engine/context.h>
#include <iclk/engine/result.h>

namespace embed {
namespace {

using iclk::Error;
using iclk::ErrorCode;
using iclk::engine::check;

constexpr const char* kLayer = "VK_LAYER_KHRONOS_validation";

VKAPI_ATTR VkBool32 VKAPI_CALL report(VkDebugUtilsMessageSeverityFlagBitsEXT, VkDebugUtilsMessageTypeFlagsEXT,
                                      const VkDebugUtilsMessengerCallbackDataEXT* data, void* count) {
  ++*static_cast<std::atomic<int>*>(count);
  std::fprintf(stderr, "validation: %s\n", data->pMessage);
  return VK_FALSE;
}

bool has_layer() {
  uint32_t count = 0;
  check(vkEnumerateInstanceLayerProperties(&count, nullptr), "vkEnumerateInstanceLayerProperties");
  std::vector<VkLayerProperties> layers(count);
  check(vkEnumerateInstanceLayerProperties(&count, layers.data()), "vkEnumerateInstanceLayerProperties");
  for (const VkLayerProperties& layer : layers)
    if (std::strcmp(layer.layerName, kLayer) == 0) return true;
  return false;
}

bool has_instance_extension(const char* name) {
  uint32_t count = 0;
  check(vkEnumerateInstanceExtensionProperties(nullptr, &count, nullptr), "vkEnumerateInstanceExtensionProperties");
  std::vector<VkExtensionProperties> extensions(count);
  check(vkEnumerateInstanceExtensionProperties(nullptr, &count, extensions.data()), "vkEnumerateInstanceExtensionProperties");
  for (const VkExtensionProperties& extension : extensions)
    if (std::strcmp(extension.extensionName, name) == 0) return true;
  return false;
}

}  // namespace

// Delegates to a constructor that does nothing, so that the destructor cleans up behind whatever throws here.
Host::Host(const std::string& wish, bool validate) : Host() {
  const auto infos = iclk::engine::list_devices();
  const auto choice = iclk::engine::choose_device(infos, wish);
  device_name = infos[choice.index].name;
  cpu_unasked = choice.cpu_unasked;
  create_instance(validate);
  uint32_t count = 0;
  check(vkEnumeratePhysicalDevices(instance, &count, nullptr), "vkEnumeratePhysicalDevices");
  std::vector<VkPhysicalDevice> devices(count);
  check(vkEnumeratePhysicalDevices(instance, &count, devices.data()), "vkEnumeratePhysicalDevices");
  if (choice.index >= count)
    throw Error(ErrorCode::no_device, device_name + " has disappeared since the devices were listed; run again");
  physical_device = devices[choice.index];
  create_device();

  const VkCommandPoolCreateInfo pool{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO, nullptr,
                                     VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT, queue_family};
  check(vkCreateCommandPool(device, &pool, nullptr, &pool_), "vkCreateCommandPool");
  const VkCommandBufferAllocateInfo one{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO, nullptr, pool_,
                                        VK_COMMAND_BUFFER_LEVEL_PRIMARY, 1};
  check(vkAllocateCommandBuffers(device, &one, &commands_), "vkAllocateCommandBuffers");
  const VkFenceCreateInfo fence{VK_STRUCTURE_TYPE_FENCE_CREATE_INFO, nullptr, 0};
  check(vkCreateFence(device, &fence, nullptr, &fence_), "vkCreateFence");
}

void Host::create_instance(bool validate) {
  VkApplicationInfo application{VK_STRUCTURE_TYPE_APPLICATION_INFO};
  application.pApplicationName = "iclk_embed";
  application.apiVersion = iclk::engine::requirements().api_version;
  VkInstanceCreateInfo info{VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO};
  info.pApplicationInfo = &application;
  std::vector<const char*> extensions;
  if (has_instance_extension(VK_KHR_PORTABILITY_ENUMERATION_EXTENSION_NAME)) {  // or MoltenVK's devices are not listed
    extensions.push_back(VK_KHR_PORTABILITY_ENUMERATION_EXTENSION_NAME);
    info.flags |= VK_INSTANCE_CREATE_ENUMERATE_PORTABILITY_BIT_KHR;
  }
  const VkValidationFeatureEnableEXT synchronisation = VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT;
  VkDebugUtilsMessengerCreateInfoEXT messenger{VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT};
  messenger.messageSeverity = VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT;
  messenger.messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_TYPE_PERFORMANCE_BIT_EXT;
  messenger.pfnUserCallback = report;
  messenger.pUserData = &messages_;
  VkValidationFeaturesEXT features{VK_STRUCTURE_TYPE_VALIDATION_FEATURES_EXT, &messenger, 1, &synchronisation, 0, nullptr};
  if (validate) {
    if (!has_layer())
      throw Error(ErrorCode::unsupported, std::string(kLayer) + " is not installed; install vulkan-validationlayers");
    info.pNext = &features;
    info.enabledLayerCount = 1;
    info.ppEnabledLayerNames = &kLayer;
    extensions.insert(extensions.end(), {VK_EXT_DEBUG_UTILS_EXTENSION_NAME, VK_EXT_VALIDATION_FEATURES_EXTENSION_NAME});
  }
  info.enabledExtensionCount = static_cast<uint32_t>(extensions.size());
  info.ppEnabledExtensionNames = extensions.data();
  check(vkCreateInstance(&info, nullptr, &instance), "vkCreateInstance");
  if (!validate) return;
  const auto create =
      reinterpret_cast<PFN_vkCreateDebugUtilsMessengerEXT>(vkGetInstanceProcAddr(instance, "vkCreateDebugUtilsMessengerEXT"));
  check(create(instance, &messenger, nullptr, &messenger_), "vkCreateDebugUtilsMessengerEXT");
}

// iclk asks for no extension and no feature, so this is the application's own device: a renderer adds what it needs. Vulkan on
// top of another API (MoltenVK) wants its subset named.
void Host::create_device() {
  uint32_t count = 0;
  vkGetPhysicalDeviceQueueFamilyProperties(physical_device, &count, nullptr);
  std::vector<VkQueueFamilyProperties> families(count);
  vkGetPhysicalDeviceQueueFamilyProperties(physical_device, &count, families.data());
  queue_family = static_cast<uint32_t>(iclk::engine::choose_queue_family(families, iclk::engine::requirements().queue_flags));
  VkPhysicalDeviceProperties properties;
  vkGetPhysicalDeviceProperties(physical_device, &properties);
  if (families[queue_family].timestampValidBits >= 36)  // wraps after a minute at the least
    ns_per_tick = static_cast<double>(properties.limits.timestampPeriod);

  const float priority = 1;
  VkDeviceQueueCreateInfo one_queue{VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO};
  one_queue.queueFamilyIndex = queue_family;
  one_queue.queueCount = 1;
  one_queue.pQueuePriorities = &priority;
  VkDeviceCreateInfo info{VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO};
  info.queueCreateInfoCount = 1;
  info.pQueueCreateInfos = &one_queue;
  constexpr const char* portability_subset = "VK_KHR_portability_subset";
  uint32_t extensions_n = 0;
  check(vkEnumerateDeviceExtensionProperties(physical_device, nullptr, &extensions_n, nullptr), "vkEnumerateDeviceExtensions");
  std::vector<VkExtensionProperties> extensions(extensions_n);
  check(vkEnumerateDeviceExtensionProperties(physical_device, nullptr, &extensions_n, extensions.data()),
        "vkEnumerateDeviceExtensions");
  for (const VkExtensionProperties& extension : extensions)
    if (std::strcmp(extension.extensionName, portability_subset) == 0) info.enabledExtensionCount = 1;
  info.ppEnabledExtensionNames = &portability_subset;
  check(vkCreateDevice(physical_device, &info, nullptr, &device), "vkCreateDevice", device_name);
  vkGetDeviceQueue(device, queue_family, 0, &queue);
}

Host::~Host() {
  if (device) {
    vkDeviceWaitIdle(device);
    vkDestroyFence(device, fence_, nullptr);
    vkDestroyCommandPool(device, pool_, nullptr);
    vkDestroyDevice(device, nullptr);
  }
  if (messenger_) {
    const auto destroy = reinterpret_cast<PFN_vkDestroyDebugUtilsMessengerEXT>(
        vkGetInstanceProcAddr(instance, "vkDestroyDebugUtilsMessengerEXT"));
    destroy(instance, messenger_, nullptr);
  }
  if (instance) vkDestroyInstance(instance, nullptr);
}

VkCommandBuffer Host::begin() {
  VkCommandBufferBeginInfo info{VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
  info.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
  check(vkBeginCommandBuffer(commands_, &info), "vkBeginCommandBuffer");
  return commands_;
}

void Host::submit_and_wait() {
  check(vkEndCommandBuffer(commands_), "vkEndCommandBuffer");
  VkSubmitInfo info{VK_STRUCTURE_TYPE_SUBMIT_INFO};
  info.commandBufferCount = 1;
  info.pCommandBuffers = &commands_;
  check(vkQueueSubmit(queue, 1, &info, fence_), "vkQueueSubmit", device_name);
  check(vkWaitForFences(device, 1, &fence_, VK_TRUE, UINT64_MAX), "vkWaitForFences", device_name);
  check(vkResetFences(device, 1, &fence_), "vkResetFences");
}

uint32_t Host::memory_type(uint32_t bits, VkMemoryPropertyFlags properties) const {
  VkPhysicalDeviceMemoryProperties memory;
  vkGetPhysicalDeviceMemoryProperties(physical_device, &memory);
  for (uint32_t i = 0; i < memory.memoryTypeCount; ++i)
    if ((bits >> i & 1) && (memory.memoryTypes[i].propertyFlags & properties) == properties) return i;
  throw Error(ErrorCode::unsupported,
              device_name + " has no memory type that this example needs; choose another with --device");
}

}  // namespace embed
