#pragma once
// Flights over terrain with a small camera, for tests of long recordings.
#include <iclk/track/internal/tracker_impl.h>

#include "flight.h"

namespace iclk::test {
namespace {

const Camera kSmall{140, 140, 79.5, 59.5, 160, 120};

inline TrackerOptions small_options() {
  TrackerOptions options;
  options.features = 80;
  options.border = 6;
  options.min_inliers = 15;
  options.depth_sigma = {.relative = 0.001};
  options.keyframes = 8;
  options.window = 3;
  return options;
}

inline SE3 looking_down(double x, double y) {
  Eigen::Matrix3d down;
  down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  return {down, Eigen::Vector3d(x, y, 120)};
}

struct Shot {
  SE3 T_WC;
  enum class How { clear, covered, blurred, dim } how = How::clear;
  double seconds = 0.1;  // since the one before
};

/// The mean of views from 24 m of the way: 28 px of motion blur.
inline View blurred(TerrainRenderer& renderer, const SE3& T_WC) {
  View out = renderer.render(kSmall, T_WC);
  constexpr uint32_t kViews = 5;
  std::vector<std::array<uint32_t, 3>> sums(out.rgba.size());
  for (uint32_t i = 0; i < kViews; ++i) {
    SE3 moved = T_WC;
    moved.t.x() += 6.0 * (i - 2.0);
    const View view = renderer.render(kSmall, moved);
    for (size_t at = 0; at < sums.size(); ++at)
      for (size_t c = 0; c < 3; ++c) sums[at][c] += view.rgba[at] >> (8 * c) & 0xff;
  }
  for (size_t at = 0; at < sums.size(); ++at)
    out.rgba[at] = sums[at][0] / kViews | sums[at][1] / kViews << 8 | sums[at][2] / kViews << 16 | 0xff000000;
  return out;
}

/// Light that is half as bright, and falls off to one side.
inline void dim(View& view) {
  for (size_t at = 0; at < view.rgba.size(); ++at) {
    const double x = static_cast<double>(at % static_cast<size_t>(view.width)) / view.width;
    uint32_t pixel = 0xff000000;
    for (uint32_t c = 0; c < 3; ++c) {
      const double grey = (view.rgba[at] >> (8 * c) & 0xff) / 255.0;
      pixel |= static_cast<uint32_t>(255 * (0.55 - 0.25 * x) * std::pow(grey, 1.3) + 0.5) << (8 * c);
    }
    view.rgba[at] = pixel;
  }
}

inline View take(TerrainRenderer& renderer, const Shot& shot) {
  if (shot.how == Shot::How::blurred) return blurred(renderer, shot.T_WC);
  View view = renderer.render(kSmall, shot.T_WC);
  if (shot.how == Shot::How::dim) dim(view);
  if (shot.how == Shot::How::covered) {
    std::fill(view.rgba.begin(), view.rgba.end(), 0xff000000);
    std::fill(view.depth.begin(), view.depth.end(), 0.0F);
  }
  return view;
}

struct Flown {
  std::vector<TrackResult> results;
  std::vector<int> maps_of;    // of every frame, in the end; -1: lost
  std::vector<double> errors;  // m, of every frame from the first one of its map, by the keyframes' last poses
  double worst = 0;            // of them
  int lost = 0, maps = 0;
  size_t loops = 0;
};

inline void expect_the_same(const TrackResult& a, const TrackResult& b) {
  EXPECT_EQ(a.status, b.status);
  EXPECT_EQ(a.keyframe, b.keyframe);
  EXPECT_EQ(a.T_WC.R, b.T_WC.R);
  EXPECT_EQ(a.T_WC.t, b.T_WC.t);
}

/// `stopped`: the frame at which a second tracker continues from the state of the first one; both must go on equally.
inline Flown fly(const std::shared_ptr<const Terrain>& terrain, const std::vector<Shot>& shots, const TrackerOptions& options,
                 std::optional<size_t> stopped = {}) {
  TerrainRenderer renderer(device(), terrain);
  AlignerOptions how;
  how.search = true;
  const auto make = [&] { return make_device_aligner(device(), Tracker::plan(kSmall, options), how, Solver::device); };
  const auto aligner = make(), another = make();
  Tracker tracker(*aligner, kSmall, options), continued(*another, kSmall, options);
  Flown out;
  double time = 0;
  for (size_t i = 0; i < shots.size(); ++i) {
    if (stopped == i) continued.restore(tracker.state());
    const View view = take(renderer, shots[i]);
    const TrackFrame frame{time += shots[i].seconds, view.image(), view.depth_image(), {}};
    out.results.push_back(tracker.track(frame));
    if (stopped && i >= *stopped) expect_the_same(out.results.back(), continued.track(frame));
  }
  std::map<int, SE3> starts;  // of maps, in the world
  for (size_t i = 0; i < shots.size(); ++i) {
    const TrackResult& r = out.results[i];
    out.errors.push_back(0);
    out.maps_of.push_back(-1);
    out.lost += r.status == TrackStatus::lost;
    if (r.status == TrackStatus::lost) continue;
    const SE3 T_WC = tracker.keyframe_pose(r.keyframe) * r.T_CK.inverse();
    out.maps_of.back() = tracker.keyframe_map(r.keyframe);
    const SE3& start = starts.emplace(out.maps_of.back(), shots[i].T_WC * T_WC.inverse()).first->second;
    out.errors.back() = (T_WC.t - (start.inverse() * shots[i].T_WC).t).norm();
  }
  out.worst = *std::max_element(out.errors.begin(), out.errors.end());
  out.maps = static_cast<int>(starts.size());
  out.loops = tracker.internals().loops.state.loops.size();
  return out;
}

}  // namespace
}  // namespace iclk::test
