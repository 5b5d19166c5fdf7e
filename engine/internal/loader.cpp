#include <iclk/engine/internal/loader.h>

#ifdef _WIN32
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
#else
#include <dlfcn.h>
#endif

#include <string>

#include <iclk/engine/error.h>

namespace iclk::engine {
namespace {

/// The names of the loader. MoltenVK, which works without a loader, is last.
#if defined(_WIN32)
constexpr const char* names[] = {"vulkan-1.dll"};
#elif defined(__APPLE__)
constexpr const char* names[] = {"libvulkan.1.dylib", "libvulkan.dylib", "libMoltenVK.dylib"};
#elif defined(__ANDROID__)
constexpr const char* names[] = {"libvulkan.so"};
#else
constexpr const char* names[] = {"libvulkan.so.1"};
#endif

#ifdef _WIN32
/// Never closed, as below.
std::shared_ptr<void> open(const char* name, std::string& why) {
  const HMODULE library = LoadLibraryA(name);
  if (!library) why = std::string(name) + ": Windows error " + std::to_string(GetLastError());
  return {static_cast<void*>(library), [](void*) {}};
}
void* symbol(void* library, const char* name) {
  return reinterpret_cast<void*>(GetProcAddress(static_cast<HMODULE>(library), name));
}
#else
std::shared_ptr<void> open(const char* name, std::string& why) {
  // NODELETE: drivers register thread-exit handlers that must not outlive their code.
  void* library = dlopen(name, RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
  if (!library) {
    const char* reason = dlerror();
    why = reason ? reason : std::string(name) + " cannot be opened";
    return {};
  }
  return {library, [](void* handle) { dlclose(handle); }};
}
void* symbol(void* library, const char* name) { return dlsym(library, name); }
#endif

}  // namespace

Loader::Loader() {
  std::string why;
  const char* found = nullptr;
  for (const char* name : names) {
    library_ = open(name, why);
    found = name;
    if (library_) break;
  }
  if (!library_)
    throw Error(ErrorCode::no_driver,
                "no Vulkan loader: " + why + "; install libvulkan1 and a driver (mesa-vulkan-drivers), or use the CPU solver");
  get_ = reinterpret_cast<PFN_vkGetInstanceProcAddr>(symbol(library_.get(), "vkGetInstanceProcAddr"));
  if (!get_)
    throw Error(ErrorCode::no_driver, std::string(found) + " has no vkGetInstanceProcAddr; reinstall the Vulkan loader");
}

}  // namespace iclk::engine
