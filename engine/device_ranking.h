#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

namespace iclk::engine {

/// Device types, best first.
enum class DeviceType { discrete, integrated, virtual_gpu, cpu, other };
const char* name(DeviceType type);

/// The properties of a Vulkan device.
struct DeviceInfo {
  std::string name;  ///< "llvmpipe (LLVM 15.0.6, 256 bits)"
  DeviceType type = DeviceType::other;
  std::array<uint8_t, 16> uuid{};          ///< VkPhysicalDeviceIDProperties::deviceUUID
  uint32_t api_version = 0;                ///< VK_MAKE_API_VERSION
  uint32_t driver_version = 0;             ///< packed as the vendor defines
  std::string driver_name;                 ///< "llvmpipe Mesa 22.3.6 (LLVM 15.0.6)"; empty: unknown
  uint64_t device_memory = 0;              ///< bytes of the largest device-local heap
  uint64_t max_storage_buffer_range = 0;   ///< bytes of one storage buffer binding
  uint64_t max_texel_buffer_elements = 0;  ///< texels of one texel buffer
  uint32_t max_workgroup_invocations = 0;
  uint32_t max_shared_memory = 0;    ///< bytes of one workgroup
  uint32_t subgroup_size = 0;        ///< invocations
  uint32_t subgroup_operations = 0;  ///< VkSubgroupFeatureFlags in compute shaders; 0: do not use subgroups
  std::string rejected;              ///< why iclk cannot use it; empty: usable
};

/// Formats a UUID as "9b1e6c0a-....", the form that choose_device() accepts and `iclk devices` prints.
std::string uuid_text(const std::array<uint8_t, 16>& uuid);

/// Lists devices: "0 llvmpipe (LLVM 15.0.6, 256 bits) [cpu]; 1 Foo [discrete] rejected: Vulkan 1.0, needs 1.1", or "none".
std::string describe(std::span<const DeviceInfo> devices);

struct DeviceChoice {
  size_t index = 0;
  bool cpu_unasked = false;  ///< a CPU device was chosen although the request did not name one: tell the user
};

/// Chooses a device. Makes no Vulkan calls.
///
/// `request` is one of
/// - empty: the best usable device: discrete, then integrated, virtual, CPU, other; the first of equal ones;
/// - an index into `devices`: decimal digits. A number of three digits or more is an index only if it is below the count;
///   else it is a name ("4090");
/// - a UUID: 32 hexadecimal digits, with dashes anywhere;
/// - part of a name, upper or lower case: the best usable match, in the same order as above.
///
/// Throws Error(no_device) if no device matches or no match is usable; the message lists all devices and their defects.
DeviceChoice choose_device(std::span<const DeviceInfo> devices, std::string_view request);

}  // namespace iclk::engine
