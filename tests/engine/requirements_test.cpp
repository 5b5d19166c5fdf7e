#include <iclk/engine/requirements.h>

#include <gtest/gtest.h>

namespace iclk::engine {
namespace {

DeviceCapabilities good() {
  DeviceCapabilities device;
  device.api_version = VK_MAKE_API_VERSION(0, 1, 3, 230);
  device.limits.maxPerStageDescriptorStorageBuffers = 32;
  device.limits.maxTexelBufferElements = 1u << 26;
  device.limits.maxPushConstantsSize = 128;
  device.limits.maxComputeWorkGroupInvocations = 1024;
  device.limits.maxComputeSharedMemorySize = 32768;
  device.queue_families = {{VK_QUEUE_GRAPHICS_BIT | VK_QUEUE_COMPUTE_BIT, 1, 64, {1, 1, 1}}};
  return device;
}

TEST(Requirements, NothingIsMissing) { EXPECT_EQ(unmet(requirements(), good()), ""); }

TEST(Requirements, EachShortcomingIsNamedWithItsNumbers) {
  DeviceCapabilities device = good();
  device.api_version = VK_MAKE_API_VERSION(0, 1, 0, 3);
  EXPECT_EQ(unmet(requirements(), device), "Vulkan 1.0.3, needs 1.1.0");
  device = good();
  device.queue_families[0].queueFlags = VK_QUEUE_GRAPHICS_BIT;
  EXPECT_EQ(unmet(requirements(), device), "no queue family with compute");
  device = good();
  device.limits.maxPerStageDescriptorStorageBuffers = 4;
  EXPECT_EQ(unmet(requirements(), device), "maxPerStageDescriptorStorageBuffers 4, needs 8");
  device.limits.maxPerStageDescriptorStorageBuffers = 8;
  EXPECT_EQ(unmet(requirements(), device), "");
  device.limits.maxTexelBufferElements = 65536;
  EXPECT_EQ(unmet(requirements(), device), "maxPerStageDescriptorStorageBuffers 8, needs 11");
}

TEST(Requirements, ExtensionsAndFeaturesOfADeviceAreCompared) {
  DeviceRequirements needed = requirements();
  needed.device_extensions = {"VK_KHR_one", "VK_KHR_two"};
  needed.features.shaderFloat64 = VK_TRUE;
  DeviceCapabilities device = good();
  device.device_extensions = {"VK_KHR_two"};
  EXPECT_EQ(unmet(needed, device), "no VK_KHR_one; a core feature is missing");
  device.features.shaderFloat64 = VK_TRUE;
  device.device_extensions.push_back("VK_KHR_one");
  EXPECT_EQ(unmet(needed, device), "");
}

TEST(Requirements, AFamilyWithoutGraphicsIsPreferred) {
  constexpr VkQueueFlags G = VK_QUEUE_GRAPHICS_BIT, C = VK_QUEUE_COMPUTE_BIT, T = VK_QUEUE_TRANSFER_BIT;
  const auto families = [](std::initializer_list<VkQueueFlags> flags) {
    std::vector<VkQueueFamilyProperties> result;
    for (VkQueueFlags f : flags) result.push_back({f, 1, 0, {1, 1, 1}});
    return result;
  };
  EXPECT_EQ(choose_queue_family(families({G | C | T}), C), 0);
  EXPECT_EQ(choose_queue_family(families({G | C | T, T, C | T}), C), 2);
  EXPECT_EQ(choose_queue_family(families({T, G}), C), -1);
  auto empty = families({C, G | C});
  empty[0].queueCount = 0;
  EXPECT_EQ(choose_queue_family(empty, C), 1);
  EXPECT_EQ(choose_queue_family({}, C), -1);
}

}  // namespace
}  // namespace iclk::engine
