#include <iclk/engine/vulkan_functions.h>

#include <string>

#include <iclk/engine/error.h>

namespace iclk::engine {
namespace {

template <class Function>
void require(Function& member, PFN_vkVoidFunction pointer, const char* name) {
  if (!pointer)
    throw Error(ErrorCode::unsupported,
                std::string("the Vulkan implementation lacks ") + name +
                    "; iclk needs Vulkan 1.1, also as VkApplicationInfo::apiVersion of an adopted instance");
  member = reinterpret_cast<Function>(pointer);
}

}  // namespace

InstanceFunctions load_instance_functions(PFN_vkGetInstanceProcAddr get, VkInstance instance) {
  InstanceFunctions functions;
#define X(name) require(functions.name, get(instance, "vk" #name), "vk" #name);
  ICLK_INSTANCE_FUNCTIONS(X)
#undef X
  return functions;
}

DeviceFunctions load_device_functions(PFN_vkGetDeviceProcAddr get, VkDevice device) {
  DeviceFunctions functions;
#define X(name) require(functions.name, get(device, "vk" #name), "vk" #name);
  ICLK_DEVICE_FUNCTIONS(X)
#undef X
  return functions;
}

}  // namespace iclk::engine
