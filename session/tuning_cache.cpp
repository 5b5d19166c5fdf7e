#include <iclk/session/tuning_cache.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>

#include <iclk/engine/error.h>
#include <iclk/session/io/output.h>

namespace iclk {
namespace {

// Far more than any model has layers: what is larger is no file of ours.
constexpr size_t kMostBytes = 1u << 20;

std::string absolute(const char* variable) {
  const char* value = std::getenv(variable);
  return value && value[0] == '/' ? value : "";
}

}  // namespace

TuningMode tuning_mode(const std::string& value) {
  if (value == "off") return TuningMode::off;
  if (value.empty() || value == "cache") return TuningMode::cache;
  throw Error(ErrorCode::invalid_argument, "ICLK_TUNING is '" + value + "'; it may be off or cache");
}

TuningMode tuning_mode() {
  const char* wish = std::getenv("ICLK_TUNING");
  return tuning_mode(wish != nullptr ? wish : "");
}

std::string cache_folder() {
  if (const std::string cache = absolute("XDG_CACHE_HOME"); !cache.empty()) return cache + "/iclk";
  if (const std::string home = absolute("HOME"); !home.empty()) return home + "/.cache/iclk";
  return {};
}

std::string tuning_file(const engine::Context& context, const std::string& folder) {
  return folder + "/tuning-" + tuning_key(context) + ".txt";
}

Tuning read_tuning(const engine::Context& context, const std::string& folder) {
  if (folder.empty()) return {};
  std::ifstream file(tuning_file(context, folder), std::ios::binary);
  std::string text(kMostBytes, '\0');
  file.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<size_t>(std::max<std::streamsize>(file.gcount(), 0)));
  return Tuning::parse(text, tuning_key(context)).value_or(Tuning{});
}

void write_tuning(const engine::Context& context, const std::string& folder, const Tuning& tuning) {
  make_output_folder(folder);
  write_file(tuning_file(context, folder), tuning.text(tuning_key(context)));
}

}  // namespace iclk
