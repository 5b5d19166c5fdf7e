#pragma once
#include <optional>
#include <string>

#include <CLI/CLI.hpp>

#include "apps/iclk/session/pair_input.h"
#include "apps/iclk/session/run_pairs.h"

namespace iclk {

/// The options that align, batch and bench share, as text until they are checked.
struct RunOptions {
  SessionOptions chosen;
  std::string solver = "host", search = "auto", damping = "fixed", camera_sigma = "auto";
  std::optional<std::string> robust;

  void add_to(CLI::App& command);
  /// Reads the models: SessionOptions::stages. Throws Error(invalid_argument) that names the value, Error(io) for a model that
  /// is not there.
  SessionOptions session() const;
};

/// The options by which files become pairs.
struct LoadOptions {
  std::string camera, distortion, detector = "shi-tomasi", depth_sigma = "auto";
  std::string mask;
  double depth_scale = 0;
  bool depth_along_ray = false;
  uint64_t max_pixels = kMaxPixels;
  DetectorOptions features;

  void add_to(CLI::App& command, bool camera_required);
  /// Throws Error that names the value or the camera file.
  InputOptions input() const;
};

/// Says on standard error what a person should know about the device that runs this.
void report_device(const Session& session);

}  // namespace iclk
