#include <iclk/engine/result.h>

#include <cstdio>

namespace iclk::engine {

const char* name(VkResult result) {
  switch (result) {
#define X(code) \
  case code: return #code;
    X(VK_SUCCESS)
    X(VK_NOT_READY)
    X(VK_TIMEOUT)
    X(VK_INCOMPLETE)
    X(VK_ERROR_OUT_OF_HOST_MEMORY)
    X(VK_ERROR_OUT_OF_DEVICE_MEMORY)
    X(VK_ERROR_INITIALIZATION_FAILED)
    X(VK_ERROR_DEVICE_LOST)
    X(VK_ERROR_MEMORY_MAP_FAILED)
    X(VK_ERROR_LAYER_NOT_PRESENT)
    X(VK_ERROR_EXTENSION_NOT_PRESENT)
    X(VK_ERROR_FEATURE_NOT_PRESENT)
    X(VK_ERROR_INCOMPATIBLE_DRIVER)
    X(VK_ERROR_TOO_MANY_OBJECTS)
    X(VK_ERROR_FORMAT_NOT_SUPPORTED)
    X(VK_ERROR_FRAGMENTED_POOL)
    X(VK_ERROR_OUT_OF_POOL_MEMORY)
    X(VK_ERROR_INVALID_EXTERNAL_HANDLE)
    X(VK_ERROR_UNKNOWN)
#undef X
    default: return "unknown VkResult";
  }
}

void check(VkResult result, const char* call, const std::string& details) {
  if (result >= 0) return;
  ErrorCode code = ErrorCode::vulkan;
  const char* remedy = "";
  switch (result) {
    case VK_ERROR_OUT_OF_HOST_MEMORY:
    case VK_ERROR_OUT_OF_DEVICE_MEMORY:
    case VK_ERROR_OUT_OF_POOL_MEMORY:
    case VK_ERROR_FRAGMENTED_POOL:
    case VK_ERROR_MEMORY_MAP_FAILED: code = ErrorCode::out_of_memory; break;
    case VK_ERROR_DEVICE_LOST:
      code = ErrorCode::device_lost;
      remedy = "; destroy all objects of this device and create them again";
      break;
    default: break;
  }
  std::string message = std::string(call) + ": " + name(result) + " (" + std::to_string(static_cast<int>(result)) + ")";
  if (!details.empty()) message += "; " + details;
  throw Error(code, message + remedy);
}

std::string bytes_in_words(VkDeviceSize bytes) {
  const char* unit = bytes >= (1ull << 30) ? "GiB" : "MiB";
  const double value = static_cast<double>(bytes) / static_cast<double>(bytes >= (1ull << 30) ? 1ull << 30 : 1ull << 20);
  char text[64];
  std::snprintf(text, sizeof text, "%.2f %s (%llu bytes)", value, unit, static_cast<unsigned long long>(bytes));
  return text;
}

}  // namespace iclk::engine
