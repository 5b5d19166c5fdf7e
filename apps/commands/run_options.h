#pragma once
#include <string>

#include <CLI/CLI.hpp>

#include "apps/session/alignment_wish.h"
#include "apps/session/pair_input.h"
#include "apps/session/session.h"

namespace iclk {

/// The options that align, batch and bench share, as text until they are checked.
struct RunOptions : AlignmentWish {
  std::string solver = "host", device, camera_sigma = "auto";
  RefinerOptions refiner;
  bool no_refine = false;

  void add_to(CLI::App& command);
  /// Reads the model. Throws Error(invalid_argument) that names the value, Error(io) for a model that is not there.
  /// `guessed`: the pairs come with a first guess, about which nothing is searched unless --search on.
  SessionOptions session(bool guessed = false) const;
};

/// The options by which files become pairs.
struct LoadOptions {
  std::string camera, distortion, detector = "shi-tomasi", depth_sigma = "auto";
  std::string mask;
  double depth_scale = 0;
  uint64_t max_pixels = kMaxPixels;
  DetectorOptions features;

  void add_to(CLI::App& command, bool camera_required);
  /// Throws Error that names the value or the camera file.
  InputOptions input() const;
};

/// Says on standard error what a person should know about the device that runs this.
void report_device(const Session& session);

}  // namespace iclk
