#pragma once
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <iclk/align/se3.h>
#include <iclk/session/io/camera_file.h>

#include "apps/iclk/io/stereo_file.h"

namespace iclk {

struct SequenceFrame {
  double stamp = 0;          ///< of the colour image, seconds
  std::string image, depth;  ///< paths that can be opened; depth is empty where none lies near in time
  std::optional<SE3> T_wc;   ///< camera to world at the colour image's time, interpolated; nothing outside the ground truth
  std::string right;         ///< of a stereo recording: the right image, in place of a depth image
};

/// A recording, with its groundtruth.txt and camera.txt where they exist.
struct Sequence {
  std::string folder;
  std::optional<CameraFile> camera;   ///< of camera.txt
  std::optional<StereoFile> rig;      ///< of a stereo recording
  std::vector<SequenceFrame> frames;  ///< in order of time
  double unit = 1;                    ///< s of one unit of time in the files
};

/// The files of a folder, hidden ones left out, in the order of their names as a person counts: frame2 before frame10. Throws
/// Error(io).
std::vector<std::filesystem::path> list_files(const std::filesystem::path& folder);

struct SequenceOptions {
  double max_difference = 0.04;  ///< s, between an image and its depth
  double rate = 30;              ///< frames a second, where names hold no times
  bool need_depth = true;        ///< else a recording without depth is one, too
};

/// A folder in the TUM RGB-D layout (rgb.txt, depth.txt): image and depth are paired by time, nearest first, each used once.
/// Without rgb.txt, a folder `rgb`, `color`, `images` or `image` with a folder `depth` or `depths`: paired by the files' names
/// without ending, in the order of the numbers in them. Names that are times are times: numbers with a point, of 16 digits
/// or more, or from 1e9 on. Times are in seconds, milliseconds, microseconds or nanoseconds, as time_unit() finds.
/// Throws Error(io) for a missing file, Error(invalid_argument) "<file>:<line>: ..." for a broken line or an empty list.
Sequence load_sequence(const std::string& folder, const SequenceOptions& options = {});

/// Frame i against frame i + stride.
struct SequencePair {
  int frame_0 = 0, frame_1 = 0;
  std::string reference, target, depth;  ///< depth is the reference's
  std::optional<SE3> T_10;               ///< truth: camera 0 to camera 1 = T_w1^-1 T_w0
};

/// Every pair whose reference has depth. Throws Error(invalid_argument) for stride < 1.
std::vector<SequencePair> make_pairs(const Sequence& sequence, int stride);

}  // namespace iclk
