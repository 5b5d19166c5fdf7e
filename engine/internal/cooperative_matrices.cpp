#include <iclk/engine/internal/cooperative_matrices.h>

#include <algorithm>
#include <vector>

namespace iclk::engine {
namespace {

// Of VK_KHR_cooperative_matrix, which the headers of Debian 12 lack.
constexpr auto kMatrixProperties = static_cast<VkStructureType>(1000506001),
               kMatrixStages = static_cast<VkStructureType>(1000506002);
constexpr int kFloat16 = 0, kFloat32 = 1, kSubgroup = 3;
struct Properties {
  VkStructureType type;
  void* next;
  uint32_t m, n, k;
  int a, b, c, result;
  VkBool32 saturating;
  int scope;
};
using GetProperties = VkResult(VKAPI_PTR*)(VkPhysicalDevice, uint32_t*, Properties*);
struct Stages {
  VkStructureType type;
  void* next;
  VkShaderStageFlags supported;
};

}  // namespace

MatrixFeatures::MatrixFeatures(VkBool32 on) {
  half_.shaderFloat16 = matrices_.cooperative_matrix = on;
  model_.vulkanMemoryModel = model_.vulkanMemoryModelDeviceScope = on;
  half_.pNext = &model_;
  model_.pNext = &matrices_;
}

MatrixSize matrix_size(PFN_vkGetInstanceProcAddr get, VkInstance instance, VkPhysicalDevice device,
                       const DeviceCapabilities& capabilities) {
  const auto& extensions = capabilities.device_extensions;
  for (const char* name : kMatrixExtensions)
    if (std::find(extensions.begin(), extensions.end(), name) == extensions.end()) return {};
  const auto properties_of =
      reinterpret_cast<GetProperties>(get(instance, "vkGetPhysicalDeviceCooperativeMatrixPropertiesKHR"));
  const auto features_of = reinterpret_cast<PFN_vkGetPhysicalDeviceFeatures2>(get(instance, "vkGetPhysicalDeviceFeatures2"));
  const auto device_properties =
      reinterpret_cast<PFN_vkGetPhysicalDeviceProperties2>(get(instance, "vkGetPhysicalDeviceProperties2"));
  if (!properties_of || !features_of || !device_properties) return {};

  MatrixFeatures offered(VK_FALSE);
  VkPhysicalDeviceFeatures2 features{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2, offered.chain(), {}};
  features_of(device, &features);
  Stages stages{kMatrixStages, nullptr, 0};
  VkPhysicalDeviceProperties2 properties{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2, &stages, {}};
  device_properties(device, &properties);
  if (!offered.all() || !(stages.supported & VK_SHADER_STAGE_COMPUTE_BIT)) return {};

  uint32_t count = 0;
  if (properties_of(device, &count, nullptr) != VK_SUCCESS) return {};
  Properties blank{};
  blank.type = kMatrixProperties;
  std::vector<Properties> all(count, blank);
  if (properties_of(device, &count, all.data()) < 0) return {};
  all.resize(count);
  MatrixSize best;
  for (const Properties& p : all) {
    const bool fits = p.m && p.n && p.k && kMatrixTile % p.m == 0 && kMatrixTile % p.n == 0 && kMatrixTile % p.k == 0 &&
                      p.k % 4 == 0 && p.n % 4 == 0;
    if (!fits || p.a != kFloat16 || p.b != kFloat16 || p.c != kFloat32 || p.result != kFloat32 || p.saturating ||
        p.scope != kSubgroup)
      continue;
    if (p.m * p.n * p.k > best.m * best.n * best.k) best = {p.m, p.n, p.k};
  }
  return best;
}

}  // namespace iclk::engine
