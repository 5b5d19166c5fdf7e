#include <iclk/engine/device_ranking.h>

#include <algorithm>
#include <cctype>
#include <optional>
#include <vector>

#include <iclk/engine/error.h>

namespace iclk::engine {
namespace {

bool is_digit(char c) { return c >= '0' && c <= '9'; }

std::string lower(std::string_view text) {
  std::string result(text);
  for (char& c : result) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return result;
}

std::string_view trimmed(std::string_view text) {
  while (!text.empty() && std::isspace(static_cast<unsigned char>(text.front()))) text.remove_prefix(1);
  while (!text.empty() && std::isspace(static_cast<unsigned char>(text.back()))) text.remove_suffix(1);
  return text;
}

std::optional<size_t> as_index(std::string_view request, size_t count) {
  if (request.empty() || request.size() > 6 || !std::all_of(request.begin(), request.end(), is_digit)) return std::nullopt;
  const size_t index = std::stoul(std::string(request));
  // A wrong index must not match part of a name, such as the 1 of "LLVM 15".
  return index < count || request.size() < 3 ? std::optional(index) : std::nullopt;
}

/// 32 lower-case hexadecimal digits, or nothing. nvidia-smi writes GPU- before them.
std::optional<std::string> as_uuid(std::string_view request) {
  if (lower(request.substr(0, 4)) == "gpu-") request.remove_prefix(4);
  std::string digits;
  for (char c : lower(request)) {
    if (c == '-') continue;
    if (!is_digit(c) && (c < 'a' || c > 'f')) return std::nullopt;
    digits += c;
  }
  return digits.size() == 32 ? std::optional(digits) : std::nullopt;
}

std::vector<size_t> matches(std::span<const DeviceInfo> devices, std::string_view request) {
  if (const auto index = as_index(request, devices.size()))
    return *index < devices.size() ? std::vector{*index} : std::vector<size_t>{};
  const auto uuid = as_uuid(request);
  const std::string part = lower(request);
  std::vector<size_t> found;
  for (size_t i = 0; i < devices.size(); ++i) {
    const bool match =
        uuid ? as_uuid(uuid_text(devices[i].uuid)) == uuid : lower(devices[i].name).find(part) != std::string::npos;
    if (match) found.push_back(i);
  }
  return found;
}

}  // namespace

const char* name(DeviceType type) {
  switch (type) {
    case DeviceType::discrete: return "discrete";
    case DeviceType::integrated: return "integrated";
    case DeviceType::virtual_gpu: return "virtual";
    case DeviceType::cpu: return "cpu";
    case DeviceType::other: return "other";
  }
  return "unknown";
}

std::string uuid_text(const std::array<uint8_t, 16>& uuid) {
  static constexpr char hex[] = "0123456789abcdef";
  std::string text;
  for (size_t i = 0; i < uuid.size(); ++i) {
    if (i == 4 || i == 6 || i == 8 || i == 10) text += '-';
    text += hex[uuid[i] >> 4];
    text += hex[uuid[i] & 15];
  }
  return text;
}

std::string describe(std::span<const DeviceInfo> devices) {
  if (devices.empty()) return "none";
  std::string text;
  for (size_t i = 0; i < devices.size(); ++i) {
    if (i) text += "; ";
    text += std::to_string(i) + " " + devices[i].name + " [" + name(devices[i].type) + "]";
    if (!devices[i].rejected.empty()) text += " rejected: " + devices[i].rejected;
  }
  return text;
}

DeviceChoice choose_device(std::span<const DeviceInfo> devices, std::string_view request) {
  request = trimmed(request);
  const std::vector<size_t> found = matches(devices, request);
  const std::string asked = std::string("'").append(request).append("'");
  if (found.empty())
    throw Error(ErrorCode::no_device,
                (request.empty() ? "no Vulkan device" : "no device matches " + asked) + "; devices: " + describe(devices));
  std::optional<size_t> best;
  for (size_t i : found)
    if (devices[i].rejected.empty() && (!best || devices[i].type < devices[*best].type)) best = i;
  if (!best)
    throw Error(ErrorCode::no_device, (request.empty() ? "no usable Vulkan device" : "no usable device matches " + asked) +
                                          "; devices: " + describe(devices));
  return {*best, request.empty() && devices[*best].type == DeviceType::cpu};
}

}  // namespace iclk::engine
