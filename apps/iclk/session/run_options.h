#pragma once
#include <optional>
#include <string>

#include <CLI/CLI.hpp>

#include "apps/iclk/common/settings.h"
#include "apps/iclk/session/pair_input.h"
#include "apps/iclk/session/run_pairs.h"

namespace iclk {

/// The options that align, batch, eval and demo share.
struct RunOptions {
  SessionOptions chosen;
  std::string solver = "host";

  void add_to(CLI::App& command);
  void add_to(Settings& settings);
  /// Reads the models: SessionOptions::stages. Throws Error(invalid_argument) that names the value, Error(io) for a model that
  /// is not there.
  SessionOptions session() const;
};

/// The options by which files become pairs.
struct LoadOptions {
  std::string camera, distortion, depth_sigma = "auto";
  std::string mask;
  double depth_scale = 0;
  bool depth_along_ray = false;
  uint64_t max_pixels = kMaxPixels;
  DetectorOptions features;

  void add_to(CLI::App& command, bool camera_required);
  void add_to(Settings& settings);
  /// Throws Error that names the value or the camera file.
  InputOptions input() const;
};

/// Says on standard error what a person should know about the device that runs this.
void report_device(const Session& session);

}  // namespace iclk
