#pragma once
#include <string>
#include <vector>

#include <iclk/align/alignment.h>

namespace embed {

struct Options {
  std::string device;  ///< empty: the best
  std::string out = "embed.png";
  int width = 640, height = 480;
  int frames = 12;
  int features = 50;
  uint64_t seed = 1;  ///< of the terrain
  bool validate = false;
};

/// One frame: both views rendered, aligned and drawn by one submission.
struct FrameReport {
  iclk::Status status;
  double start_px = 0;  ///< mean over the features: how far the first guess is off
  double error_px = 0;  ///< the same of the pose found
  double error_m = 0, error_rad = 0;
  double ms = 0;                       ///< from the first recorded command to the end of the submission
  double render_ms = 0, align_ms = 0;  ///< of it, on the device; 0 where it has no timestamps
};

struct Report {
  std::string device;
  bool cpu_unasked = false;
  std::vector<FrameReport> frames;
  int validation_messages = 0;
};

/// Flies over a terrain made in code and follows the camera: each frame renders the map from where the camera was found last
/// (reference) and what the camera sees now (target, a stand-in for its picture), and aligns them. Writes the last frame's two
/// images, marked, side by side to Options::out. Throws iclk::Error.
Report run(const Options& options);

}  // namespace embed
