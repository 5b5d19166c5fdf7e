// A Vulkan layer for tests: lets chosen calls fail and keeps a list of what lives. See control.h.
#include <cstring>
#include <tuple>
#include <type_traits>

#include <vulkan/vk_layer.h>

#include "chain.h"
#include "faults.h"
#include "objects.h"

namespace iclk::test {
namespace {

struct Layer final : LayerControl {
  Faults faults;
  Objects objects;
  Chain<InstanceBelow> instances;
  Chain<DeviceBelow> devices;

  const std::vector<LayerCall>& calls() const override { return faults.calls(); }
  void arm(const std::string& call, uint32_t ordinal, VkResult result, uint32_t times) override {
    faults.arm(faults.index(call), ordinal, result, times);
  }
  void disarm() override { faults.disarm(); }
  bool fired() const override { return faults.fired(); }
  uint32_t count(const std::string& call) const override { return faults.count(faults.index(call)); }
  LiveObjects live() const override { return objects.live(); }
  std::vector<std::string> take_misuse() override { return objects.take_misuse(); }
};

Layer& layer() {
  static auto* const layer = new Layer;  // outlives every instance, whenever that is destroyed
  return *layer;
}

template <class Handle>
constexpr const char* type_name = nullptr;
#define X(type) \
  template <>   \
  constexpr const char* type_name<type> = #type;
X(VkDeviceMemory)
X(VkBuffer)
X(VkBufferView)
X(VkShaderModule)
X(VkPipelineCache)
X(VkPipeline)
X(VkPipelineLayout)
X(VkDescriptorSetLayout)
X(VkDescriptorPool)
X(VkCommandPool)
X(VkFence)
X(VkQueryPool)
X(VkDebugUtilsMessengerEXT)
#undef X

template <class Handle>
uint64_t id(Handle handle) {
  return reinterpret_cast<uint64_t>(handle);
}

auto& chain_of(const InstanceBelow*) { return layer().instances; }
auto& chain_of(const DeviceBelow*) { return layer().devices; }

/// A lost device has stopped: whatever was submitted will not touch memory any more.
void lose(DeviceBelow& device) {
  device.DeviceWaitIdle(device.handle);
  const std::lock_guard lock(device.mutex);
  device.lost = true;
  device.pending.clear();
}

template <class Arguments>
void note_success(DeviceBelow& device, PFN_vkQueueSubmit, const Arguments& arguments) {
  const std::lock_guard lock(device.mutex);
  if (const VkFence fence = std::get<VkFence>(arguments)) device.pending.insert(fence);
}
template <class Arguments>
void note_success(DeviceBelow& device, PFN_vkWaitForFences, const Arguments& arguments) {
  const std::lock_guard lock(device.mutex);
  for (uint32_t i = 0; i < std::get<0>(arguments); ++i) device.pending.erase(std::get<const VkFence*>(arguments)[i]);
}
template <class Below, class Function, class Arguments>
void note_success(Below&, Function, const Arguments& arguments) {
  if constexpr (std::tuple_size_v < Arguments >> 0) {
    const auto last = std::get<std::tuple_size_v<Arguments> - 1>(arguments);
    if constexpr (std::is_pointer_v<decltype(last)>)
      if constexpr (type_name<std::remove_pointer_t<std::remove_const_t<decltype(last)>>> != nullptr) {
        uint64_t bytes = 0;
        if constexpr (std::is_same_v<Function, PFN_vkAllocateMemory>)
          bytes = std::get<const VkMemoryAllocateInfo*>(arguments)->allocationSize;
        layer().objects.created(type_name<std::remove_pointer_t<std::remove_const_t<decltype(last)>>>, id(*last), bytes);
      }
  }
}

/// Handles that a failed call should have written are undefined; only pipelines are VK_NULL_HANDLE then.
template <class Arguments>
void spoil(const Arguments& arguments) {
  // Mesa's layer for the choice of a device believes the count whatever the result is.
  if constexpr (std::is_same_v<Arguments, std::tuple<const char*, uint32_t*, VkExtensionProperties*>>)
    *std::get<uint32_t*>(arguments) = 0;
  if constexpr (std::tuple_size_v < Arguments >> 0) {
    const auto last = std::get<std::tuple_size_v<Arguments> - 1>(arguments);
    if constexpr (std::is_pointer_v<decltype(last)>) {
      using Handle = std::remove_pointer_t<std::remove_const_t<decltype(last)>>;
      if constexpr (type_name<Handle> != nullptr)
        *last = std::is_same_v<Handle, VkPipeline> ? VK_NULL_HANDLE : reinterpret_cast<Handle>(uint64_t{0xbadbad});
    }
  }
}

/// A call that can fail: counted, failed on demand, handed down.
template <class Below, auto Member, class Function>
struct Failing;
template <class Below, auto Member, class Handle, class... Rest>
struct Failing<Below, Member, VkResult(VKAPI_PTR*)(Handle, Rest...)> {
  static inline size_t index = 0;
  static VKAPI_ATTR VkResult VKAPI_CALL call(Handle handle, Rest... rest) {
    const auto below = chain_of(static_cast<Below*>(nullptr)).of(handle);
    const std::tuple<Rest...> arguments(rest...);
    const std::optional<VkResult> fault = layer().faults.next(index);
    if constexpr (Below::may_be_lost) {
      if (fault == VK_ERROR_DEVICE_LOST) lose(*below);
      const std::lock_guard lock(below->mutex);
      if (below->lost && layer().faults.may_lose_device(index)) return VK_ERROR_DEVICE_LOST;
    }
    if (fault) {
      spoil(arguments);
      return *fault;
    }
    const VkResult result = ((*below).*Member)(handle, rest...);
    if (result == VK_SUCCESS) note_success(*below, (*below).*Member, arguments);
    return result;
  }
};

/// vkDestroy... and vkFreeMemory.
template <class Below, auto Member, class Function>
struct Ending;
template <class Below, auto Member, class Owner, class Handle>
struct Ending<Below, Member, void(VKAPI_PTR*)(Owner, Handle, const VkAllocationCallbacks*)> {
  static VKAPI_ATTR void VKAPI_CALL call(Owner owner, Handle handle, const VkAllocationCallbacks* allocator) {
    const auto below = chain_of(static_cast<Below*>(nullptr)).of(owner);
    if constexpr (Below::may_be_lost) {
      const std::lock_guard lock(below->mutex);
      bool in_use = false;
      if constexpr (std::is_same_v<Handle, VkFence>) in_use = below->pending.contains(handle);
      if (in_use) layer().objects.misuse(std::string(type_name<Handle>) + " destroyed while a submission is pending");
    }
    if (!handle || layer().objects.destroyed(type_name<Handle>, id(handle))) ((*below).*Member)(owner, handle, allocator);
  }
};

template <class Info>
Info* link_of(const void* next, VkStructureType type) {
  auto* info = static_cast<Info*>(const_cast<void*>(next));  // the loader's, made to be changed
  while (info && !(info->sType == type && info->function == VK_LAYER_LINK_INFO))
    info = static_cast<Info*>(const_cast<void*>(info->pNext));
  return info;
}

VKAPI_ATTR VkResult VKAPI_CALL create_instance(const VkInstanceCreateInfo* info, const VkAllocationCallbacks* allocator,
                                               VkInstance* instance) {
  if (const auto fault = layer().faults.next(layer().faults.index("vkCreateInstance"))) return *fault;
  auto* link = link_of<VkLayerInstanceCreateInfo>(info->pNext, VK_STRUCTURE_TYPE_LOADER_INSTANCE_CREATE_INFO);
  if (!link) return VK_ERROR_INITIALIZATION_FAILED;
  const PFN_vkGetInstanceProcAddr get = link->u.pLayerInfo->pfnNextGetInstanceProcAddr;
  link->u.pLayerInfo = link->u.pLayerInfo->pNext;
  const auto create = reinterpret_cast<PFN_vkCreateInstance>(get(nullptr, "vkCreateInstance"));
  const VkResult result = create(info, allocator, instance);
  if (result != VK_SUCCESS) return result;
  const auto below = layer().instances.add(*instance);
  below->handle = *instance;
  below->get = get;
  const auto load = [&](auto& function, const char* name) {
    function = reinterpret_cast<std::remove_reference_t<decltype(function)>>(get(*instance, name));
  };
  load(below->DestroyInstance, "vkDestroyInstance");
  load(below->EnumeratePhysicalDevices, "vkEnumeratePhysicalDevices");
  load(below->EnumerateDeviceExtensionProperties, "vkEnumerateDeviceExtensionProperties");
  load(below->CreateDevice, "vkCreateDevice");
  load(below->CreateDebugUtilsMessengerEXT, "vkCreateDebugUtilsMessengerEXT");
  load(below->DestroyDebugUtilsMessengerEXT, "vkDestroyDebugUtilsMessengerEXT");
  layer().objects.created("VkInstance", id(*instance));
  return VK_SUCCESS;
}

VKAPI_ATTR void VKAPI_CALL destroy_instance(VkInstance instance, const VkAllocationCallbacks* allocator) {
  if (!instance) return;
  const auto below = layer().instances.of(instance);
  layer().instances.remove(instance);
  layer().objects.destroyed("VkInstance", id(instance));
  below->DestroyInstance(instance, allocator);
}

VKAPI_ATTR VkResult VKAPI_CALL create_device(VkPhysicalDevice physical, const VkDeviceCreateInfo* info,
                                             const VkAllocationCallbacks* allocator, VkDevice* device) {
  if (const auto fault = layer().faults.next(layer().faults.index("vkCreateDevice"))) return *fault;
  auto* link = link_of<VkLayerDeviceCreateInfo>(info->pNext, VK_STRUCTURE_TYPE_LOADER_DEVICE_CREATE_INFO);
  if (!link) return VK_ERROR_INITIALIZATION_FAILED;
  const PFN_vkGetInstanceProcAddr get_instance = link->u.pLayerInfo->pfnNextGetInstanceProcAddr;
  const PFN_vkGetDeviceProcAddr get = link->u.pLayerInfo->pfnNextGetDeviceProcAddr;
  link->u.pLayerInfo = link->u.pLayerInfo->pNext;
  const auto create =
      reinterpret_cast<PFN_vkCreateDevice>(get_instance(layer().instances.of(physical)->handle, "vkCreateDevice"));
  const VkResult result = create(physical, info, allocator, device);
  if (result != VK_SUCCESS) return result;
  const auto below = layer().devices.add(*device);
  below->handle = *device;
  below->get = get;
#define X(name) below->name = reinterpret_cast<PFN_vk##name>(get(*device, "vk" #name));
  ICLK_DEVICE_FUNCTIONS(X)
#undef X
  layer().objects.created("VkDevice", id(*device));
  return VK_SUCCESS;
}

VKAPI_ATTR void VKAPI_CALL destroy_device(VkDevice device, const VkAllocationCallbacks* allocator) {
  if (!device) return;
  const auto below = layer().devices.of(device);
  if (!below->pending.empty()) layer().objects.misuse("VkDevice destroyed while a submission is pending");
  layer().devices.remove(device);
  layer().objects.destroyed("VkDevice", id(device));
  below->DestroyDevice(device, allocator);
}

using Hooks = std::map<std::string, PFN_vkVoidFunction>;

template <class Below, auto Member>
void hook(Hooks& hooks, const char* name) {
  using Function = std::remove_cvref_t<decltype(std::declval<Below>().*Member)>;
  if constexpr (std::is_same_v<Function, PFN_vkDestroyDevice>) {
    hooks[name] = reinterpret_cast<PFN_vkVoidFunction>(destroy_device);
  } else if constexpr (requires { Ending<Below, Member, Function>::call; }) {
    hooks[name] = reinterpret_cast<PFN_vkVoidFunction>(Ending<Below, Member, Function>::call);
  } else if constexpr (requires { Failing<Below, Member, Function>::call; }) {
    if (std::strcmp(name, "vkResetDescriptorPool") == 0) return;  // cannot fail
    Failing<Below, Member, Function>::index = layer().faults.index(name);
    hooks[name] = reinterpret_cast<PFN_vkVoidFunction>(Failing<Below, Member, Function>::call);
  }
}

const Hooks& device_hooks() {
  static const Hooks hooks = [] {
    Hooks all;
#define X(name) hook<DeviceBelow, &DeviceBelow::name>(all, "vk" #name);
    ICLK_DEVICE_FUNCTIONS(X)
#undef X
    return all;
  }();
  return hooks;
}

const Hooks& instance_hooks() {
  static const Hooks hooks = [] {
    Hooks all = device_hooks();
#define X(name) hook<InstanceBelow, &InstanceBelow::name>(all, "vk" #name);
    X(EnumeratePhysicalDevices)
    X(EnumerateDeviceExtensionProperties)
    X(CreateDebugUtilsMessengerEXT)
    X(DestroyDebugUtilsMessengerEXT)
#undef X
    all["vkCreateInstance"] = reinterpret_cast<PFN_vkVoidFunction>(create_instance);
    all["vkDestroyInstance"] = reinterpret_cast<PFN_vkVoidFunction>(destroy_instance);
    all["vkCreateDevice"] = reinterpret_cast<PFN_vkVoidFunction>(create_device);
    return all;
  }();
  return hooks;
}

}  // namespace
}  // namespace iclk::test

extern "C" {

iclk::test::LayerControl* iclk_test_layer() { return &iclk::test::layer(); }

VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL iclk_test_layer_get_device(VkDevice device, const char* name) {
  if (std::strcmp(name, "vkGetDeviceProcAddr") == 0) return reinterpret_cast<PFN_vkVoidFunction>(iclk_test_layer_get_device);
  const auto& hooks = iclk::test::device_hooks();
  if (const auto found = hooks.find(name); found != hooks.end()) return found->second;
  return iclk::test::layer().devices.of(device)->get(device, name);
}

VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL iclk_test_layer_get_instance(VkInstance instance, const char* name) {
  if (std::strcmp(name, "vkGetInstanceProcAddr") == 0)
    return reinterpret_cast<PFN_vkVoidFunction>(iclk_test_layer_get_instance);
  if (std::strcmp(name, "vkGetDeviceProcAddr") == 0) return reinterpret_cast<PFN_vkVoidFunction>(iclk_test_layer_get_device);
  const auto& hooks = iclk::test::instance_hooks();
  const auto found = hooks.find(name);
  // Of the layer that it calls first the loader asks vkCreateInstance with an instance that is not made yet.
  if (!instance || std::strcmp(name, "vkCreateInstance") == 0) return found != hooks.end() ? found->second : nullptr;
  const PFN_vkVoidFunction below = iclk::test::layer().instances.of(instance)->get(instance, name);
  return below && found != hooks.end() ? found->second : below;
}
}
