#pragma once
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <iclk/track/tracker.h>
#include <iclk/track/trajectory.h>

#include "apps/io/camera_file.h"
#include "apps/io/distortion.h"
#include "apps/io/sequence.h"

namespace iclk {

struct TrackRunOptions {
  std::string folder;                    ///< TUM RGB-D
  std::optional<CameraFile> camera;      ///< none: the folder's camera.txt
  std::optional<Distortion> distortion;  ///< none: the camera file's
  double depth_scale = 0;                ///< 0: the camera file's
  int first = 0, count = 0, stride = 1;  ///< frames: from, at most (0: all), every so many
  Solver solver = Solver::device;
  std::string device;
  std::string model = "classical";  ///< or a name or file of a model
  TrackerOptions tracker;
  std::string out;  ///< folder; empty: nothing is written
};

/// Errors against the recording's truth, of the frames that have one and were not lost.
struct TrackErrors {
  TrajectoryError absolute;
  RelativeError relative;  ///< over 30 frames
  double way = 0;          ///< m
  int frames = 0;
};

struct TrackReport {
  std::string device;
  bool cpu_unasked = false;
  int frames = 0, lost = 0, unconfirmed = 0, keyframes = 0, without_depth = 0;
  double seconds = 0;                                   ///< in Tracker::track()
  double align_ms = 0, keyframe_ms = 0, bundle_ms = 0;  ///< sums
  std::optional<TrackErrors> live, adjusted;            ///< as they were answered, and by the keyframes' last poses
};

/// Tracks a recording. With `out`: live.txt (TUM, as answered) and frames.jsonl grow with every frame; trajectory.txt (TUM, by
/// the keyframes' last poses), keyframes.txt, trajectory_kitti.txt, map.ply and path.png are written at the end, whole or not
/// at all. Frames that cannot be read are an Error. `progress`: frames done, of how many, lost so far.
TrackReport track_sequence(const TrackRunOptions& options, const std::function<void(int, int, int)>& progress);

/// The report as lines of text.
std::string to_text(const TrackReport& report);

}  // namespace iclk
