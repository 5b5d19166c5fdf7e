// iclk_embed: an application with a Vulkan device of its own that aligns what it renders, within its own command buffer. The
// part to read is run() in run.cpp.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>

#include <CLI/CLI.hpp>

#include <iclk/engine/error.h>

#include "apps/embed/run.h"

namespace {

// Frames are right if the pose found puts the features within this of their true places, in the mean, and says converged.
constexpr double kRightPx = 0.15;

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

int report(const embed::Options& options, const embed::Report& result) {
  int wrong = 0;
  std::printf("frame   start px   error px   error m   error deg   status\n");
  for (size_t i = 0; i < result.frames.size(); ++i) {
    const embed::FrameReport& f = result.frames[i];
    const bool right = f.status == iclk::Status::converged && f.error_px < kRightPx;
    wrong += !right;
    std::printf("%5zu %10.2f %10.4f %9.4f %11.5f   %s%s\n", i + 1, f.start_px, f.error_px, f.error_m, f.error_rad * 180 / M_PI,
                iclk::name(f.status), right ? "" : ": WRONG");
  }
  const auto middle = [&](double embed::FrameReport::*time) {
    std::vector<double> all;
    for (const embed::FrameReport& f : result.frames) all.push_back(f.*time);
    return median(all);
  };
  std::printf("\none frame   %.2f ms (median; recording, one submission, waiting; on %s)\n", middle(&embed::FrameReport::ms),
              result.device.c_str());
  if (result.frames.front().render_ms > 0)
    std::printf("of which    %.2f ms two views of %dx%d, %.2f ms alignment, by the device's clock\n",
                middle(&embed::FrameReport::render_ms), options.width, options.height, middle(&embed::FrameReport::align_ms));
  if (options.validate) std::printf("validation  %d messages\n", result.validation_messages);
  std::printf(
      "picture     %s: the map from the last known pose; the camera's view with the features found (crosses) and their "
      "true positions (rings)\n",
      options.out.c_str());
  if (wrong > 0) std::fprintf(stderr, "iclk_embed: %d of %zu poses are wrong\n", wrong, result.frames.size());
  if (result.validation_messages > 0)
    std::fprintf(stderr, "iclk_embed: the validation layer reported %d messages\n", result.validation_messages);
  return wrong > 0 || result.validation_messages > 0 ? 1 : 0;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "iclk_embed: an example application that renders, aligns and draws in one command buffer of its own Vulkan device");
  embed::Options options;
  if (const char* wish = std::getenv("ICLK_DEVICE")) options.device = wish;
  std::string size = "640x480";
  app.add_option("--device", options.device,
                 "Vulkan device: index, UUID or part of the name (see `iclk devices`); default: ICLK_DEVICE, else the best");
  app.add_option("--frames", options.frames, "Frames of the flight, 4 m apart")
      ->check(CLI::Range(1, 100000))
      ->capture_default_str();
  app.add_option("--size", size, "Image size, WIDTHxHEIGHT, 160x120 to 4096x4096")->capture_default_str();
  app.add_option("--features", options.features, "Most features per image")->check(CLI::Range(12, 2000))->capture_default_str();
  app.add_option("--seed", options.seed, "Seed of the terrain")->capture_default_str();
  app.add_option("--out", options.out, "PNG of the last frame")->capture_default_str();
  app.add_flag("--validate", options.validate,
               "Run with the Khronos validation layer and synchronisation validation; any message is a failure");
  app.footer(
      "Exit codes: 0 every pose is right, 1 a pose is wrong or --validate reported a message, 2 an error.\n\n"
      "Examples:\n  iclk_embed\n  iclk_embed --frames 100 --size 752x480 --out flight.png\n  iclk_embed --validate --device 0");
  try {
    app.parse(argc, argv);
    int used = 0;
    if (std::sscanf(size.c_str(), "%dx%d%n", &options.width, &options.height, &used) != 2 ||
        static_cast<size_t>(used) != size.size() || options.width < 160 || options.height < 120 || options.width > 4096 ||
        options.height > 4096)
      throw CLI::ValidationError("--size", "'" + size + "' is not WIDTHxHEIGHT between 160x120 and 4096x4096");
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }
  try {
    const embed::Report result = embed::run(options);
    if (result.cpu_unasked)
      std::fprintf(stderr, "iclk_embed: no GPU with Vulkan found: running on %s\n", result.device.c_str());
    return report(options, result);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "iclk_embed: %s\n", e.what());
    return 2;
  }
}
