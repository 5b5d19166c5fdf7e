#pragma once
#include <optional>
#include <string>
#include <vector>

#include <iclk/locate/locator.h>
#include <iclk/session/io/camera_file.h>

#include "apps/iclk/common/progress.h"
#include "apps/iclk/locate/output.h"

namespace iclk {

struct LocateRun {
  std::vector<std::string> frames;  ///< images, or one folder: of images, or a recording with rgb.txt, whose times count
  std::string ortho, elevation, prior, out;
  CameraFile camera;
  std::optional<Distortion> distortion;  ///< none: the camera file's
  LocatePrior sigmas;                    ///< its pose is not used
  LocatorOptions locator;
  std::string device;
};

struct LocateReport {
  std::vector<LocatedFrame> frames;
  int without_prior = 0;  ///< frames that were left out
  double seconds = 0;     ///< of locating all frames
};

/// Locates the frames and writes located.jsonl, trajectory.txt, located.geojson and overlay/ to `out`.
/// Throws Error(invalid_argument) if no frame has a prior or the map does not reach one, and the errors of the readers.
LocateReport run_locate(const LocateRun& run, const Progress& progress);

}  // namespace iclk
