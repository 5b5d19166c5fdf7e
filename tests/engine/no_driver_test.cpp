// What a machine without Vulkan sees. VK_DRIVER_FILES is read by newer loaders, VK_ICD_FILENAMES by all; both point to nowhere.
#include <cstdlib>

#include <gtest/gtest.h>

#include <iclk/engine/context.h>
#include <iclk/engine/error.h>

namespace iclk::engine {
namespace {

template <class Call>
std::string refusal(Call call) {
  setenv("VK_DRIVER_FILES", "/nowhere/icd.json", 1);
  setenv("VK_ICD_FILENAMES", "/nowhere/icd.json", 1);
  try {
    call();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::no_driver);
    return error.what();
  }
  ADD_FAILURE() << "no error";
  return {};
}

/// Set by the run of this program whose libvulkan.so.1 cannot be opened.
bool without_loader() { return std::getenv("ICLK_TEST_NO_LOADER") != nullptr; }

TEST(NoDriver, IsATypedErrorWithARemedy) {
  for (int repeat = 0; repeat < 3; ++repeat) {
    for (const std::string& message : {refusal([] { create_context(); }), refusal([] { list_devices(); })}) {
      EXPECT_EQ(message.find(without_loader() ? "no Vulkan loader" : "no Vulkan driver"), 0u) << message;
      EXPECT_NE(message.find("CPU solver"), std::string::npos) << message;
    }
  }
  if (!without_loader()) return;
  HostDevice host;  // of handles that are never dereferenced: there is no loader to do it
  host.instance = reinterpret_cast<VkInstance>(8);
  host.physical_device = reinterpret_cast<VkPhysicalDevice>(8);
  host.device = reinterpret_cast<VkDevice>(8);
  host.queue = reinterpret_cast<VkQueue>(8);
  refusal([&] { adopt_device(host); });
}

}  // namespace
}  // namespace iclk::engine
