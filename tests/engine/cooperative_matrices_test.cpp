// Which cooperative matrices are taken, of devices that nobody here has: their answers are made up.
#include <iclk/engine/internal/cooperative_matrices.h>

#include <gtest/gtest.h>

#include <algorithm>
#include <string_view>
#include <vector>

namespace iclk::engine {
namespace {

// VkCooperativeMatrixPropertiesKHR, which the headers of Debian 12 lack.
struct Offer {
  VkStructureType type{};
  void* next = nullptr;
  uint32_t m = 16, n = 16, k = 16;
  int a = 0, b = 0, c = 1, result = 1;  // VK_COMPONENT_TYPE_FLOAT16_KHR is 0, FLOAT32 1
  VkBool32 saturating = VK_FALSE;
  int scope = 3;  // VK_SCOPE_SUBGROUP_KHR
};

struct Device {
  std::vector<Offer> offers = {Offer{}};
  bool half = true, model = true, device_scope = true, matrices = true;
  VkShaderStageFlags stages = VK_SHADER_STAGE_COMPUTE_BIT;
  bool knows_function = true;
  VkResult result = VK_SUCCESS;
};
Device device;

struct Chained {
  VkStructureType type;
  void* next;
  VkBool32 flags[2];
};

void VKAPI_CALL features_of(VkPhysicalDevice, VkPhysicalDeviceFeatures2* features) {
  for (auto* each = static_cast<Chained*>(features->pNext); each; each = static_cast<Chained*>(each->next)) {
    if (each->type == VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_FLOAT16_INT8_FEATURES) each->flags[0] = device.half;
    if (each->type == static_cast<VkStructureType>(1000506000)) each->flags[0] = device.matrices;
    if (each->type == VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_MEMORY_MODEL_FEATURES) {
      each->flags[0] = device.model;
      each->flags[1] = device.device_scope;
    }
  }
}

void VKAPI_CALL properties_of(VkPhysicalDevice, VkPhysicalDeviceProperties2* properties) {
  for (auto* each = static_cast<Chained*>(properties->pNext); each; each = static_cast<Chained*>(each->next))
    if (each->type == static_cast<VkStructureType>(1000506002)) each->flags[0] = device.stages;
}

VkResult VKAPI_CALL offers_of(VkPhysicalDevice, uint32_t* count, Offer* offers) {
  const auto all = static_cast<uint32_t>(device.offers.size());
  if (offers) std::copy_n(device.offers.begin(), std::min(*count, all), offers);
  *count = all;
  return device.result;
}

PFN_vkVoidFunction VKAPI_CALL get(VkInstance, const char* name) {
  const std::string_view wanted = name;
  if (wanted == "vkGetPhysicalDeviceFeatures2") return reinterpret_cast<PFN_vkVoidFunction>(features_of);
  if (wanted == "vkGetPhysicalDeviceProperties2") return reinterpret_cast<PFN_vkVoidFunction>(properties_of);
  if (wanted == "vkGetPhysicalDeviceCooperativeMatrixPropertiesKHR" && device.knows_function)
    return reinterpret_cast<PFN_vkVoidFunction>(offers_of);
  return nullptr;
}

MatrixSize size_of(const Device& of) {
  device = of;
  DeviceCapabilities capabilities;
  capabilities.device_extensions.assign(kMatrixExtensions.begin(), kMatrixExtensions.end());
  return matrix_size(get, VK_NULL_HANDLE, VK_NULL_HANDLE, capabilities);
}

Offer offer(uint32_t m, uint32_t n, uint32_t k) {
  Offer made;
  made.m = m, made.n = n, made.k = k;
  return made;
}

TEST(CooperativeMatrices, OfSeveralSizesTheLargestThatDividesATile) {
  EXPECT_EQ(size_of({}), (MatrixSize{16, 16, 16}));
  EXPECT_EQ(size_of({.offers = {offer(8, 8, 8), offer(16, 8, 16), offer(16, 8, 8)}}), (MatrixSize{16, 8, 16}));
  EXPECT_EQ(size_of({.offers = {offer(32, 32, 16), offer(8, 8, 16), offer(16, 16, 32), offer(64, 8, 8)}}),
            (MatrixSize{8, 8, 16}));
  EXPECT_FALSE(size_of({.offers = {offer(12, 16, 16), offer(16, 2, 16), offer(16, 16, 2), offer(0, 0, 0)}}));
  EXPECT_FALSE(size_of({.offers = {}}));
}

TEST(CooperativeMatrices, OtherTypesAndScopesAreNotTaken) {
  const std::vector<void (*)(Offer&)> changes = {
      [](Offer& o) { o.a = 1; },      [](Offer& o) { o.b = 3; },     [](Offer& o) { o.c = 0; },
      [](Offer& o) { o.result = 0; }, [](Offer& o) { o.scope = 2; }, [](Offer& o) { o.saturating = VK_TRUE; },
  };
  for (size_t i = 0; i < changes.size(); ++i) {
    Offer other = offer(16, 16, 16);
    changes[i](other);
    EXPECT_FALSE(size_of({.offers = {other}})) << i;
    EXPECT_EQ(size_of({.offers = {other, offer(8, 8, 8)}}), (MatrixSize{8, 8, 8})) << i;
  }
}

TEST(CooperativeMatrices, EachFeatureIsNeeded) {
  EXPECT_FALSE(size_of({.half = false}));
  EXPECT_FALSE(size_of({.model = false}));
  EXPECT_FALSE(size_of({.device_scope = false}));
  EXPECT_FALSE(size_of({.matrices = false}));
  EXPECT_FALSE(size_of({.stages = VK_SHADER_STAGE_FRAGMENT_BIT}));
  EXPECT_FALSE(size_of({.knows_function = false}));
  EXPECT_FALSE(size_of({.result = VK_ERROR_OUT_OF_HOST_MEMORY}));
}

TEST(CooperativeMatrices, EachExtensionIsNeeded) {
  device = {};
  for (size_t left_out = 0; left_out < kMatrixExtensions.size(); ++left_out) {
    DeviceCapabilities capabilities;
    for (size_t i = 0; i < kMatrixExtensions.size(); ++i)
      if (i != left_out) capabilities.device_extensions.push_back(kMatrixExtensions[i]);
    EXPECT_FALSE(matrix_size(get, VK_NULL_HANDLE, VK_NULL_HANDLE, capabilities)) << kMatrixExtensions[left_out];
  }
}

}  // namespace
}  // namespace iclk::engine
