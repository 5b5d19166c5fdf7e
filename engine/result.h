#pragma once
#include <string>

#include <vulkan/vulkan_core.h>

#include <iclk/engine/error.h>

namespace iclk::engine {

/// The name of a result, for example "VK_ERROR_DEVICE_LOST".
const char* name(VkResult result);

/// Throws Error for every negative VkResult, with code out_of_memory, device_lost or vulkan. The message is "`call`:
/// VK_ERROR_...; `details`". Details state the request: the number of bytes, or the name of the kernel.
void check(VkResult result, const char* call, const std::string& details = {});

/// Like check(), for a call that creates `handle`. A failed call leaves it undefined; it is set to null before the throw.
template <class Handle>
void check_made(VkResult result, Handle& handle, const char* call, const std::string& details = {}) {
  if (result < 0) handle = VK_NULL_HANDLE;
  check(result, call, details);
}

/// Formats a size, for example "1.50 GiB (1610612736 bytes)".
std::string bytes_in_words(VkDeviceSize bytes);

}  // namespace iclk::engine
