#pragma once
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <iclk/track/tracker.h>

#include "apps/iclk/track/run.h"

namespace iclk {

/// The name of the contract of a line of frames.jsonl, with its number: docs/schema/frame-1.json. A key may be added; where one
/// goes or means something else, the number is another one.
inline constexpr const char* kFrameSchema = "iclk-frame-1";

/// A frame that was tracked, with its pose and map by the keyframe's last ones, and the truth if there is one.
struct TrackedFrame {
  TrackResult result;
  int map = 0;
  SE3 T_WC;
  std::optional<SE3> truth;
};

/// "timestamp tx ty tz qx qy qz qw" a frame that was not lost, camera to world: what evo reads.
std::string tum_text(std::span<const TrackedFrame> frames);
/// The same of all maps, each line with the number of its map in front.
std::string maps_text(std::span<const TrackedFrame> frames);
/// The first three rows of T_WC a frame that was not lost.
std::string kitti_text(std::span<const TrackedFrame> frames);
/// A line of frames.jsonl, and what it says: all but covariance and origin. Throws Error(invalid_argument) for another line.
std::string frame_json(const TrackResult& result);
TrackResult parse_frame_json(std::string_view line);
/// The features of the held keyframes of a map, grey values as colours: an ASCII PLY.
std::string map_ply(const Tracker& tracker, int map);
/// PNG of the way from above (the two directions in which it is longest) with keyframes and the truth.
std::string path_png(std::span<const TrackedFrame> frames, const std::vector<SE3>& keyframes, const TrackErrors* errors);

}  // namespace iclk
