#include "apps/tuning_cache.h"

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <iterator>

#include <iclk/engine/error.h>

#include "apps/io/output.h"

namespace iclk {
namespace {

// Far more than any model has layers: what is larger is no file of ours.
constexpr size_t kMostBytes = 1u << 20;

std::string absolute(const char* variable) {
  const char* value = std::getenv(variable);
  return value && value[0] == '/' ? value : "";
}

Tuning read(const std::string& path, const std::string& key) {
  std::ifstream file(path, std::ios::binary);
  std::string text(kMostBytes, '\0');
  file.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<size_t>(std::max<std::streamsize>(file.gcount(), 0)));
  return Tuning::parse(text, key).value_or(Tuning{});
}

}  // namespace

TuningMode tuning_mode(const std::string& value) {
  if (value == "off") return TuningMode::off;
  if (value.empty() || value == "cache") return TuningMode::cache;
  if (value == "force") return TuningMode::force;
  throw Error(ErrorCode::invalid_argument, "ICLK_TUNING is '" + value + "'; it may be off, cache or force");
}

std::string cache_folder() {
  if (const std::string cache = absolute("XDG_CACHE_HOME"); !cache.empty()) return cache + "/iclk";
  if (const std::string home = absolute("HOME"); !home.empty()) return home + "/.cache/iclk";
  return {};
}

Tuning cached_tuning(const std::shared_ptr<const engine::Context>& context, const Model& model, int width, int height,
                     int levels, TuningMode mode, const std::string& folder, const std::function<void(const std::string&)>& say,
                     Precision precision) {
  if (mode == TuningMode::off) return {};
  const std::string key = tuning_key(*context), path = folder + "/tuning-" + key + ".txt";
  Tuning known;
  if (!folder.empty()) known = read(path, key);
  const auto shapes = encoder_shapes(model, width, height, levels, precision);
  if (mode == TuningMode::force)
    for (const ConvShape& shape : shapes) known.variants.erase(shape);
  bool measured = false;
  const Tuning tuning = tune(context, shapes, std::move(known), [&](int layer, int layers) {
    measured = true;
    if (layer == 0)
      say("measuring kernels for " + std::to_string(layers) + " layers at " + std::to_string(width) + "x" +
          std::to_string(height) + " on " + context->info().name + ", once; ICLK_TUNING=off skips this");
  });
  if (!measured || folder.empty()) return tuning;
  try {
    make_output_folder(folder);
    write_file(path, tuning.text(key));
  } catch (const Error& error) {
    say(std::string("the measurements are not remembered: ") + error.what());
  }
  return tuning;
}

}  // namespace iclk
