#pragma once
#include <string>

#include <CLI/CLI.hpp>

#include "apps/pair_input.h"
#include "apps/session.h"

namespace iclk {

/// The options that align, batch and bench share, as text until they are checked.
struct RunOptions {
  std::string solver = "host", device, robust = "huber", damping = "fixed", search = "auto";
  double search_rotation = 0;  // degrees
  AlignerOptions aligner;
  RefinerOptions refiner;
  bool no_photometric = false, no_refine = false, dense = false;

  void add_to(CLI::App& command);
  /// Throws Error(invalid_argument) that names the value.
  /// `guessed`: the pairs come with a first guess, about which nothing is searched unless --search on.
  SessionOptions session(bool guessed = false) const;
};

/// The options by which files become pairs.
struct LoadOptions {
  std::string camera, distortion, detector = "shi-tomasi";
  double depth_scale = 0;
  DetectorOptions features;

  void add_to(CLI::App& command, bool camera_required);
  /// Throws Error that names the value or the camera file.
  InputOptions input() const;
};

/// Says on standard error what a person should know about the device that runs this.
void report_device(const Session& session);

}  // namespace iclk
