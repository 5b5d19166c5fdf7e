#include <iclk/engine/result.h>

#include <gtest/gtest.h>

namespace iclk::engine {
namespace {

TEST(Result, EveryErrorHasItsCode) {
  const auto code = [](VkResult result) {
    try {
      check(result, "vkCall", "details");
    } catch (const Error& error) {
      const std::string message = error.what();
      EXPECT_EQ(message.find(std::string("vkCall: ") + name(result)), 0u) << message;
      EXPECT_NE(message.find("; details"), std::string::npos) << message;
      return error.code();
    }
    ADD_FAILURE() << name(result) << " passed";
    return ErrorCode::io;
  };
  EXPECT_EQ(code(VK_ERROR_DEVICE_LOST), ErrorCode::device_lost);
  for (VkResult memory : {VK_ERROR_OUT_OF_HOST_MEMORY, VK_ERROR_OUT_OF_DEVICE_MEMORY, VK_ERROR_OUT_OF_POOL_MEMORY})
    EXPECT_EQ(code(memory), ErrorCode::out_of_memory);
  for (VkResult other :
       {VK_ERROR_INITIALIZATION_FAILED, VK_ERROR_FEATURE_NOT_PRESENT, VK_ERROR_UNKNOWN, static_cast<VkResult>(-1000999)})
    EXPECT_EQ(code(other), ErrorCode::vulkan);
}

TEST(Result, SuccessPasses) {
  for (VkResult result : {VK_SUCCESS, VK_NOT_READY, VK_TIMEOUT, VK_INCOMPLETE}) EXPECT_NO_THROW(check(result, "vkCall"));
}

TEST(Result, BytesInWords) {
  EXPECT_EQ(bytes_in_words(1610612736), "1.50 GiB (1610612736 bytes)");
  EXPECT_EQ(bytes_in_words(1048576), "1.00 MiB (1048576 bytes)");
}

}  // namespace
}  // namespace iclk::engine
