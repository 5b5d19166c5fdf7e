#pragma once
#include <string>
#include <utility>
#include <vector>

#include "apps/iclk/sets/render_options.h"

namespace iclk {

/// When and where of one frame.
struct FlightFrame {
  double time = 0;  ///< s
  SE3 T_WC;         ///< of the left camera, or the only one
};

/// How a flight lies on the disk, as `iclk track` reads it.
///
/// Of one camera, TUM's layout: rgb/, depth/ (32-bit float metres), rgb.txt, depth.txt, groundtruth.txt, camera.txt. Of a rig
/// EuRoC's: cam0/ and cam1/ with data/, data.csv, sensor.yaml; state_groundtruth_estimate0/data.csv; and depth/ of the left
/// camera, which EuRoC has not.
class FlightFiles {
 public:
  FlightFiles(std::vector<FlightFrame> frames, const RenderedCameras& cameras);

  std::vector<std::string> folders() const;  ///< of pixels
  /// Names of a frame's files in the folder: image, depth, and the right image of a rig.
  std::vector<std::string> of_frame(uint64_t index) const;
  /// Files that say what the others are, with their content.
  std::vector<std::pair<std::string, std::string>> lists() const;
  const std::vector<FlightFrame>& frames() const { return frames_; }

 private:
  std::string stamp(uint64_t index) const;

  std::vector<FlightFrame> frames_;
  const RenderedCameras& cameras_;
};

}  // namespace iclk
