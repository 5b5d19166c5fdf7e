#include <iclk/session/internal/pipeline_cache.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <sstream>
#include <string_view>

#include <iclk/engine/error.h>
#include <iclk/session/io/output.h>
#include <iclk/session/io/text.h>

namespace iclk::internal {
namespace {

constexpr size_t kMostBytes = size_t{256} << 20;

std::string absolute(const char* variable) {
  const char* value = std::getenv(variable);
  return value && value[0] == '/' ? value : "";
}

std::string cache_folder() {
  if (const std::string cache = absolute("XDG_CACHE_HOME"); !cache.empty()) return cache + "/iclk";
  if (const std::string home = absolute("HOME"); !home.empty()) return home + "/.cache/iclk";
  return {};
}

/// The line before the data, to detect damage: a driver may crash on damaged data.
std::string head_of(std::string_view data) {
  std::ostringstream out;
  out << "iclk pipelines " << std::hex << data.size() << " " << fnv1a(data) << "\n";
  return out.str();
}

}  // namespace

std::string pipeline_file(const engine::DeviceInfo& device) {
  const std::string folder = cache_folder();
  if (folder.empty()) return {};
  std::ostringstream out;
  out << folder << "/pipelines-" << engine::uuid_text(device.uuid) << "-" << std::hex << device.driver_version
      << "-" ICLK_VERSION ".bin";
  return out.str();
}

std::vector<uint8_t> read_pipelines(const std::string& file) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(file, error)) return {};
  try {
    const std::string bytes = read_file(file, kMostBytes);
    const std::string_view data = std::string_view(bytes).substr(std::min(bytes.find('\n'), bytes.size() - 1) + 1);
    if (!bytes.starts_with(head_of(data))) return {};
    return {data.begin(), data.end()};
  } catch (const Error&) {
    return {};  // pipelines are compiled again
  }
}

void write_pipelines(const std::string& file, const std::vector<uint8_t>& data) {
  const std::string_view bytes(reinterpret_cast<const char*>(data.data()), data.size());
  make_output_folder(std::filesystem::path(file).parent_path().string());
  write_file(file, head_of(bytes) + std::string(bytes));
}

}  // namespace iclk::internal
