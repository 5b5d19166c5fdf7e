#include <iclk/engine/internal/loader.h>

#include <dlfcn.h>

#include <string>

#include <iclk/engine/error.h>

namespace iclk::engine {

Loader::Loader() {
  // NODELETE: drivers register thread-exit handlers that must not outlive their code.
  void* library = dlopen("libvulkan.so.1", RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
  if (!library) {
    const char* reason = dlerror();
    throw Error(ErrorCode::no_driver, std::string("no Vulkan loader: ") +
                                          (reason ? reason : "libvulkan.so.1 cannot be opened") +
                                          "; install libvulkan1 and a driver (mesa-vulkan-drivers), or use the CPU solver");
  }
  library_ = std::shared_ptr<void>(library, [](void* handle) { dlclose(handle); });
  get_ = reinterpret_cast<PFN_vkGetInstanceProcAddr>(dlsym(library, "vkGetInstanceProcAddr"));
  if (!get_) throw Error(ErrorCode::no_driver, "libvulkan.so.1 has no vkGetInstanceProcAddr; reinstall the Vulkan loader");
}

}  // namespace iclk::engine
