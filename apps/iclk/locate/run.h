#pragma once
#include <optional>
#include <string>
#include <vector>

#include <iclk/locate/locator.h>
#include <iclk/session/io/camera_file.h>

#include "apps/iclk/common/progress.h"
#include "apps/iclk/locate/output.h"
#include "apps/iclk/locate/priors.h"

namespace iclk {

struct LocateRun {
  std::vector<std::string> frames;  ///< images, or one folder: of images, or a recording with rgb.txt, whose times count
  std::string ortho, elevation, out;
  PriorOptions priors;
  std::optional<CameraFile> camera;      ///< none: the calibration that the pictures state
  std::optional<Distortion> distortion;  ///< none: the camera file's
  LocatorOptions locator;
  std::string pixels;                     ///< CSV of pixels whose ground is asked for; empty: none
  std::optional<double> elevation_sigma;  ///< m, of the map's heights; none: a quarter of their spacing
  std::string device;

  /// Precondition: the camera is known.
  const Distortion& lens() const { return distortion ? *distortion : camera->distortion; }
};

struct LocateReport {
  std::vector<LocatedFrame> frames;
  std::vector<std::string> left_out;  ///< "a.jpg: it has no GPS position": frames without a prior
  int pixels = 0, pixels_on_ground = 0;
  double seconds = 0;  ///< of locating all frames
};

/// Locates the frames and writes located.jsonl, located.csv, trajectory.txt, located.geojson, ground.csv and overlay/ to
/// `out`.
/// Throws Error(invalid_argument) if no frame has a prior, the map does not reach one or no camera is known, and the errors of
/// the readers.
LocateReport run_locate(const LocateRun& run, const Progress& progress);

}  // namespace iclk
