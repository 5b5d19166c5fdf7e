#pragma once
#include <string>

#include <vulkan/vulkan_core.h>

#include <iclk/engine/error.h>

namespace iclk::engine {

/// "VK_ERROR_DEVICE_LOST".
const char* name(VkResult result);

/// Throws for every negative VkResult: out_of_memory, device_lost, or vulkan; the message is "`call`: VK_ERROR_...; `details`".
/// Details say what was asked for (the number of bytes, the kernel's name).
void check(VkResult result, const char* call, const std::string& details = {});

/// check() for a call that makes `handle`: what a failed one leaves there is undefined, and becomes null before the throw.
template <class Handle>
void check_made(VkResult result, Handle& handle, const char* call, const std::string& details = {}) {
  if (result < 0) handle = VK_NULL_HANDLE;
  check(result, call, details);
}

/// "1.50 GiB (1610612736 bytes)".
std::string bytes_in_words(VkDeviceSize bytes);

}  // namespace iclk::engine
