#pragma once
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include <iclk/rig/flex.h>
#include <iclk/rig/rig.h>
#include <iclk/session/depth_sigma.h>
#include <iclk/session/detect.h>

#include "apps/iclk/io/stereo_file.h"

namespace iclk {

/// One moment of a rig as files.
struct StereoFiles {
  std::string left, right, depth, features;  ///< depth or features, both of the left; may be empty
  std::optional<double> time;                ///< s
};

/// Pairs of a manifest (JSONL: left, right, depth | features, time; relative paths begin at its folder), or of a folder with
/// left/, right/ and maybe depth/. Throws Error(io), Error(invalid_argument) "<file>:<line>: ..." that names the key.
std::vector<StereoFiles> list_pairs(const std::string& manifest_or_folder);
/// Files of these folders in the order of their names; `depth` may be empty. Throws Error(invalid_argument) where the counts
/// differ.
std::vector<StereoFiles> list_pairs(const std::string& left, const std::string& right, const std::string& depth);

struct StereoRunOptions {
  std::vector<StereoFiles> pairs;
  StereoFile calibration;
  double depth_scale = 0;        ///< raw units a metre of 16-bit depth
  bool depth_along_ray = false;  ///< depths are distances from the left camera's centre
  double distance = 0;           ///< m: of a scene without depth, about; depths are then unknown
  DepthSigma depth_sigma;
  DetectorOptions detector;
  RigOptions rig;
  bool flex = false;
  FlexOptions bending;
  double rate = 30;  ///< pairs a second, where they have no times
  int batch = 20;    ///< pairs that the device holds at a time
  Solver solver = Solver::device;
  std::string device, out;  ///< out: folder; empty: nothing is written
};

/// Images as the left pinhole has them, for pictures.
struct StereoImages {
  cv::Mat left, right;
};

struct StereoReport {
  SE3 prior;
  Camera camera;
  RigResult rig;                              ///< not of a bending rig
  std::vector<FlexMeasurement> measurements;  ///< of a bending rig
  std::vector<std::string> reasons;           ///< of its pairs
  FlexResult flex;
  double epipolar_before = 0, epipolar_after = 0;  ///< px, of all pairs of a bending rig
  std::string device;
  bool cpu_unasked = false;
  double seconds = 0;
  bool usable() const { return rig.usable || flex.usable; }
};

/// Loads, estimates, and writes to `out`. `progress`: done, total. Throws Error.
StereoReport run_stereo(const StereoRunOptions& options, const std::function<void(int, int)>& progress);

/// What the command prints.
std::string to_text(const StereoReport& report);

}  // namespace iclk
