#pragma once
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include <iclk/locate/locator.h>

#include "apps/eval/locate/defects.h"
#include "apps/iclk/common/progress.h"

namespace iclk {

struct LocateEvalOptions {
  int frames = 200, maps = 10;  ///< frames are spread evenly over the maps
  uint64_t seed = 0;
  std::string ortho, elevation;  ///< the ground; empty: procedural, another one for each map
  bool perfect = false, season = false;
  double texel = 0;                  ///< m; 0: drawn
  double metres = 25, degrees = 15;  ///< that priors are off
  double elsewhere = 0;              ///< m that priors are off in addition, which their sigma does not know
  bool heading = true;               ///< known as well as the rest of the attitude
  bool peers = false;
  std::string export_to;  ///< a folder for the pairs of a view at the prior and the frame; empty: none
  Camera camera{420, 420, 319.5, 239.5, 640, 480};
  LocatorOptions locator;
  std::string device;

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// What one method made of one frame.
struct LocateSample {
  int map = 0, frame = 0;
  Located located = {};  ///< of a peer: status, pose
  double texels = 0;  ///< mean distance on the ground between where pixels are and where they seem to be, texels of the mosaic
  double metres = 0, degrees = 0;  ///< errors of the camera's position and attitude
  double nees = 0;                 ///< normalised_error(); NaN without a covariance
  double ms = 0, cpu_ms = 0;

  bool within() const { return located.converged() && texels < 1; }
  bool wrong() const { return located.converged() && texels > 3; }
  bool aside() const { return located.converged() && degrees > 2; }
};

struct LocateMethod {
  std::string name;
  std::vector<LocateSample> samples;
};

struct LocateEval {
  std::vector<MapDefects> maps;
  std::vector<LocateMethod> methods;  ///< iclk first
};

/// Throws the errors of GeoMap and Locator, and Error(invalid_argument) if the map is too small for a frame.
LocateEval run_locate_eval(const LocateEvalOptions& options, const Progress& progress);

/// A Markdown table, a row a method.
std::string to_table(const LocateEval& eval);
/// A JSON line a frame and method.
std::string to_lines(const LocateEval& eval);

}  // namespace iclk
