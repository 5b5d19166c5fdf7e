#pragma once
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <iclk/locate/locator.h>
#include <iclk/session/io/camera_file.h>

#include "apps/iclk/common/progress.h"
#include "apps/iclk/locate/output.h"
#include "apps/iclk/locate/priors.h"
#include "apps/json/manifest.h"

namespace iclk {

struct LocateRun {
  std::vector<std::string> frames;  ///< images and folders of images, a recording with rgb.txt, or a video
  int every = 1;                    ///< only each such frame
  Shard shard;                      ///< of these
  bool sequence = false;            ///< frames follow each other
  bool fresh = false;               ///< begins anew in `out`, whatever is there
  std::string ortho, elevation, out;
  PriorOptions priors;
  std::optional<double> anywhere;        ///< m above the ground: instead of priors, the whole map is searched
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
  std::vector<LocatedFrame> frames;   ///< in the order in which they were finished
  int before = 0;                     ///< the first so many are of earlier runs
  std::vector<std::string> left_out;  ///< "a.jpg: it has no GPS position": frames without a prior
  std::vector<std::string> failed;    ///< "a.jpg: damaged": frames that cannot be read or have an impossible prior; no line
  int pixels = 0, pixels_on_ground = 0;
  double seconds = 0;  ///< of locating all frames
};

/// Locates the frames that have no line in located.jsonl of `out`, and adds one for each. Then writes located.csv,
/// trajectory.txt, located.geojson and ground.csv of all lines; overlay/ grows meanwhile. Throws Error(invalid_argument) if no
/// frame has a prior, the map does not reach one or no camera is known; the errors of the readers, LocatedJournal and
/// load_pixels(); the error of a frame only if there is no line.
LocateReport run_locate(const LocateRun& run, const std::function<void(const ProgressState&)>& progress);

}  // namespace iclk
