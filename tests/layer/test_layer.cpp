#include "test_layer.h"

#include <dlfcn.h>

#include <cstdlib>
#include <stdexcept>

namespace iclk::test {
namespace {

void prepend(const char* variable, const std::string& value) {
  const char* there = std::getenv(variable);
  setenv(variable, (there && *there ? value + ":" + there : value).c_str(), 1);
}

LayerControl& open() {
  void* module = dlopen(ICLK_TEST_LAYER, RTLD_NOW | RTLD_LOCAL);  // the loader opens the same one
  void* get = module ? dlsym(module, "iclk_test_layer") : nullptr;
  if (!get) throw std::runtime_error(std::string("test layer: ") + dlerror());
  // Where there is a VK_LAYER_PATH, VK_ADD_LAYER_PATH is not read.
  prepend(std::getenv("VK_LAYER_PATH") ? "VK_LAYER_PATH" : "VK_ADD_LAYER_PATH", ICLK_TEST_LAYER_MANIFESTS);
  prepend("VK_INSTANCE_LAYERS", "VK_LAYER_ICLK_test");
  return *reinterpret_cast<GetLayerControl>(get)();
}

}  // namespace

LayerControl& use_test_layer() {
  static LayerControl& control = open();
  return control;
}

}  // namespace iclk::test
