#include <iclk/engine/internal/instance.h>

#include <algorithm>
#include <cstring>

#include <iclk/engine/result.h>

namespace iclk::engine {
namespace {

constexpr const char* validation_layer = "VK_LAYER_KHRONOS_validation";

VKAPI_ATTR VkBool32 VKAPI_CALL receive(VkDebugUtilsMessageSeverityFlagBitsEXT severity, VkDebugUtilsMessageTypeFlagsEXT,
                                       const VkDebugUtilsMessengerCallbackDataEXT* data, void* user) {
  auto* validation = static_cast<Validation*>(user);
  const auto level = severity >= VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT     ? MessageSeverity::error
                     : severity >= VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT ? MessageSeverity::warning
                                                                                   : MessageSeverity::info;
  try {  // no exception may pass through the driver
    const std::lock_guard lock(validation->mutex);
    if (validation->on_message) validation->on_message(level, data->pMessage ? data->pMessage : "");
  } catch (...) {
  }
  return VK_FALSE;
}

VkDebugUtilsMessengerCreateInfoEXT messenger_info(Validation* validation) {
  VkDebugUtilsMessengerCreateInfoEXT info{VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT};
  info.messageSeverity = VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT;
  info.messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_TYPE_PERFORMANCE_BIT_EXT;
  info.pfnUserCallback = receive;
  info.pUserData = validation;
  return info;
}

bool has_validation_layer(PFN_vkGetInstanceProcAddr get) {
  const auto enumerate =
      reinterpret_cast<PFN_vkEnumerateInstanceLayerProperties>(get(nullptr, "vkEnumerateInstanceLayerProperties"));
  uint32_t count = 0;
  if (!enumerate || enumerate(&count, nullptr) != VK_SUCCESS) return false;
  std::vector<VkLayerProperties> layers(count);
  if (enumerate(&count, layers.data()) < 0) return false;
  layers.resize(count);
  return std::any_of(layers.begin(), layers.end(),
                     [](const auto& l) { return std::strcmp(l.layerName, validation_layer) == 0; });
}

bool has_extension(PFN_vkGetInstanceProcAddr get, const char* name) {
  const auto enumerate =
      reinterpret_cast<PFN_vkEnumerateInstanceExtensionProperties>(get(nullptr, "vkEnumerateInstanceExtensionProperties"));
  uint32_t count = 0;
  if (!enumerate || enumerate(nullptr, &count, nullptr) != VK_SUCCESS) return false;
  std::vector<VkExtensionProperties> extensions(count);
  if (enumerate(nullptr, &count, extensions.data()) < 0) return false;
  extensions.resize(count);
  return std::any_of(extensions.begin(), extensions.end(),
                     [&](const auto& extension) { return std::strcmp(extension.extensionName, name) == 0; });
}

DeviceType type_of(VkPhysicalDeviceType type) {
  switch (type) {
    case VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU: return DeviceType::discrete;
    case VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU: return DeviceType::integrated;
    case VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU: return DeviceType::virtual_gpu;
    case VK_PHYSICAL_DEVICE_TYPE_CPU: return DeviceType::cpu;
    default: return DeviceType::other;
  }
}

}  // namespace

Instance::Instance(bool validation, std::function<void(MessageSeverity, const std::string&)> on_message) {
  const PFN_vkGetInstanceProcAddr get = loader_.get_instance_proc_addr();
  const auto create = reinterpret_cast<PFN_vkCreateInstance>(get(nullptr, "vkCreateInstance"));
  if (!create) throw Error(ErrorCode::no_driver, "the Vulkan loader has no vkCreateInstance; reinstall libvulkan1");

  VkApplicationInfo application{VK_STRUCTURE_TYPE_APPLICATION_INFO};
  application.pEngineName = "iclk";
  application.apiVersion = requirements().api_version;
  VkInstanceCreateInfo info{VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO};
  info.pApplicationInfo = &application;

  std::vector<const char*> extensions;
  // Loaders list portability drivers such as MoltenVK only with this extension. Compute needs nothing that they lack.
  if (has_extension(get, VK_KHR_PORTABILITY_ENUMERATION_EXTENSION_NAME)) {
    extensions.push_back(VK_KHR_PORTABILITY_ENUMERATION_EXTENSION_NAME);
    info.flags |= VK_INSTANCE_CREATE_ENUMERATE_PORTABILITY_BIT_KHR;
  }
  const VkValidationFeatureEnableEXT enabled[] = {VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT};
  VkValidationFeaturesEXT features{VK_STRUCTURE_TYPE_VALIDATION_FEATURES_EXT};
  features.enabledValidationFeatureCount = 1;
  features.pEnabledValidationFeatures = enabled;
  VkDebugUtilsMessengerCreateInfoEXT messenger{};
  if (validation) {
    if (!has_validation_layer(get))
      throw Error(ErrorCode::unsupported,
                  std::string(validation_layer) + " is not installed; install vulkan-validationlayers or turn validation off");
    validation_ = std::make_unique<Validation>();
    validation_->on_message = std::move(on_message);
    messenger = messenger_info(validation_.get());
    features.pNext = &messenger;  // for messages while the instance is created and destroyed
    info.pNext = &features;
    info.enabledLayerCount = 1;
    info.ppEnabledLayerNames = &validation_layer;
    extensions.push_back(VK_EXT_DEBUG_UTILS_EXTENSION_NAME);
    extensions.push_back(VK_EXT_VALIDATION_FEATURES_EXTENSION_NAME);
  }
  info.enabledExtensionCount = static_cast<uint32_t>(extensions.size());
  info.ppEnabledExtensionNames = extensions.data();
  const VkResult result = create(&info, nullptr, &handle_);
  if (result == VK_ERROR_INCOMPATIBLE_DRIVER)
    throw Error(ErrorCode::no_driver,
                "no Vulkan driver on this machine (vkCreateInstance: VK_ERROR_INCOMPATIBLE_DRIVER); install one "
                "(mesa-vulkan-drivers), check VK_DRIVER_FILES and VK_ICD_FILENAMES, or use the CPU solver");
  check(result, "vkCreateInstance");

  const auto destroy = reinterpret_cast<PFN_vkDestroyInstance>(get(handle_, "vkDestroyInstance"));
  try {
    functions_ = load_instance_functions(get, handle_);
    if (validation_) {
      const auto make = reinterpret_cast<PFN_vkCreateDebugUtilsMessengerEXT>(get(handle_, "vkCreateDebugUtilsMessengerEXT"));
      messenger.pNext = nullptr;
      if (make) check(make(handle_, &messenger, nullptr, &validation_->messenger), "vkCreateDebugUtilsMessengerEXT");
    }
  } catch (...) {
    if (destroy) destroy(handle_, nullptr);
    throw;
  }
}

Instance::~Instance() {
  if (validation_ && validation_->messenger) {
    const auto destroy = reinterpret_cast<PFN_vkDestroyDebugUtilsMessengerEXT>(
        get_instance_proc_addr()(handle_, "vkDestroyDebugUtilsMessengerEXT"));
    if (destroy) destroy(handle_, validation_->messenger, nullptr);
  }
  functions_.DestroyInstance(handle_, nullptr);
}

std::vector<VkPhysicalDevice> Instance::physical_devices() const {
  uint32_t count = 0;
  VkResult result = functions_.EnumeratePhysicalDevices(handle_, &count, nullptr);
  // Loaders return this for a driver without hardware.
  if (result == VK_ERROR_INITIALIZATION_FAILED) return {};
  check(result, "vkEnumeratePhysicalDevices");
  std::vector<VkPhysicalDevice> devices(count);
  if (count) check(functions_.EnumeratePhysicalDevices(handle_, &count, devices.data()), "vkEnumeratePhysicalDevices");
  devices.resize(count);
  return devices;
}

DeviceCapabilities capabilities_of(const InstanceFunctions& vk, VkPhysicalDevice device) {
  DeviceCapabilities result;
  VkPhysicalDeviceProperties properties;
  vk.GetPhysicalDeviceProperties(device, &properties);
  result.api_version = properties.apiVersion;
  result.limits = properties.limits;
  vk.GetPhysicalDeviceFeatures(device, &result.features);

  uint32_t count = 0;
  vk.GetPhysicalDeviceQueueFamilyProperties(device, &count, nullptr);
  result.queue_families.resize(count);
  vk.GetPhysicalDeviceQueueFamilyProperties(device, &count, result.queue_families.data());

  // A device that cannot list its extensions is treated as having none; other devices are still usable.
  std::vector<VkExtensionProperties> extensions;
  if (vk.EnumerateDeviceExtensionProperties(device, nullptr, &count, nullptr) == VK_SUCCESS) {
    extensions.resize(count);
    if (vk.EnumerateDeviceExtensionProperties(device, nullptr, &count, extensions.data()) < 0) count = 0;
    extensions.resize(count);
  }
  for (const auto& extension : extensions) result.device_extensions.emplace_back(extension.extensionName);
  return result;
}

DeviceInfo info_of(const InstanceFunctions& vk, VkPhysicalDevice device, const DeviceCapabilities& capabilities) {
  VkPhysicalDeviceDriverProperties driver{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DRIVER_PROPERTIES};
  VkPhysicalDeviceSubgroupProperties subgroup{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_PROPERTIES};
  VkPhysicalDeviceIDProperties id{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ID_PROPERTIES, &subgroup};
  VkPhysicalDeviceProperties2 properties{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2, &id};
  const bool has_driver_name = std::find(capabilities.device_extensions.begin(), capabilities.device_extensions.end(),
                                         VK_KHR_DRIVER_PROPERTIES_EXTENSION_NAME) != capabilities.device_extensions.end();
  if (has_driver_name) subgroup.pNext = &driver;

  DeviceInfo info;
  info.rejected = unmet(requirements(), capabilities);
  if (capabilities.api_version >= VK_API_VERSION_1_1) {
    vk.GetPhysicalDeviceProperties2(device, &properties);
    std::memcpy(info.uuid.data(), id.deviceUUID, info.uuid.size());
    info.subgroup_size = subgroup.subgroupSize;
    if (subgroup.supportedStages & VK_SHADER_STAGE_COMPUTE_BIT) info.subgroup_operations = subgroup.supportedOperations;
    if (has_driver_name) info.driver_name = std::string(driver.driverName) + " " + driver.driverInfo;
  } else {
    vk.GetPhysicalDeviceProperties(device, &properties.properties);
  }
  info.name = properties.properties.deviceName;
  info.type = type_of(properties.properties.deviceType);
  info.api_version = properties.properties.apiVersion;
  info.driver_version = properties.properties.driverVersion;
  info.max_storage_buffer_range = capabilities.limits.maxStorageBufferRange;
  info.max_texel_buffer_elements = capabilities.limits.maxTexelBufferElements;
  info.max_workgroup_invocations = capabilities.limits.maxComputeWorkGroupInvocations;
  info.max_shared_memory = capabilities.limits.maxComputeSharedMemorySize;
  VkPhysicalDeviceMemoryProperties memory;
  vk.GetPhysicalDeviceMemoryProperties(device, &memory);
  for (uint32_t i = 0; i < memory.memoryHeapCount; ++i)
    if (memory.memoryHeaps[i].flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT)
      info.device_memory = std::max<uint64_t>(info.device_memory, memory.memoryHeaps[i].size);
  return info;
}

}  // namespace iclk::engine
