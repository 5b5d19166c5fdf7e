#pragma once
#include <stdexcept>
#include <string>

namespace iclk {

enum class ErrorCode {
  invalid_argument,  ///< the caller's input; the message names the value and the remedy
  unsupported,       ///< valid, but more than this device or build can do
  no_driver,         ///< no Vulkan loader or no driver on this machine
  no_device,         ///< there are drivers, but no usable device that matches the request
  out_of_memory,     ///< host or device memory
  device_lost,       ///< VK_ERROR_DEVICE_LOST; objects may still be destroyed
  vulkan,            ///< any other VkResult
  io,                ///< a file could not be read or written
};

/// The exception type of the library. The library never prints or exits.
class Error : public std::runtime_error {
 public:
  Error(ErrorCode code, const std::string& message) : std::runtime_error(message), code_(code) {}
  ErrorCode code() const noexcept { return code_; }

 private:
  ErrorCode code_;
};

}  // namespace iclk
