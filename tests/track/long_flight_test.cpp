// A flight without end: what a tracker holds does not grow.
#include <unistd.h>

#include <cstdlib>
#include <fstream>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include <iclk/align/device_aligner.h>
#include <iclk/render/procedural.h>
#include <iclk/render/renderer.h>
#include <iclk/track/internal/tracker_impl.h>

#include "device.h"

namespace iclk::test {
namespace {

/// Bytes of memory that this process holds.
size_t resident() {
  std::ifstream file("/proc/self/statm");
  size_t pages = 0;
  file >> pages >> pages;
  return pages * static_cast<size_t>(sysconf(_SC_PAGESIZE));
}

/// ICLK_LONG_FRAMES=100000 for all night; the suite's is long enough for every keyframe to leave many times.
int frames_to_fly() {
  const char* const variable = std::getenv("ICLK_LONG_FRAMES");
  return variable ? std::atoi(variable) : 800;
}

TEST(LongFlight, MemoryDoesNotGrow) {
  ICLK_NEED_DEVICE();
  const Camera camera{70, 70, 39.5, 29.5, 80, 60};
  Eigen::Matrix3d down;
  down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  const auto terrain = std::make_shared<const Terrain>(procedural_terrain({.seed = 3, .size = 256}));
  TerrainRenderer renderer(device(), terrain);
  constexpr int kRound = 60;
  std::vector<View> views;
  std::vector<SE3> truth;
  for (int i = 0; i < kRound; ++i) {
    const double a = 2 * M_PI * i / kRound;
    truth.push_back({down, Eigen::Vector3d(120 + 60 * std::cos(a), 120 + 60 * std::sin(a), 150)});
    views.push_back(renderer.render(camera, truth.back()));
  }
  TrackerOptions options;
  options.features = 60;
  options.border = 6;
  options.min_inliers = 10;
  options.depth_sigma = {.relative = 0.001};
  options.keyframes = 6;
  options.archive = 40;
  options.window = 3;
  AlignerOptions how;
  how.search = true;
  const auto aligner = make_device_aligner(device(), Tracker::plan(camera, options), how, Solver::device);
  Tracker tracker(*aligner, camera, options);
  const int frames = frames_to_fly();
  size_t before = 0, state_before = 0;
  int lost = 0;
  double drift = 0, closed = 0;  // m, worst error in the first round, and after it
  for (int i = 0; i < frames; ++i) {
    const auto at = static_cast<size_t>(i % kRound);
    const TrackResult r = tracker.track({0.1 * i, views[at].image(), views[at].depth_image(), {}});
    lost += r.status == TrackStatus::lost;
    double& error = i < kRound ? drift : closed;
    error = std::max(error, (r.T_WC.t - (truth[0].inverse() * truth[at]).t).norm());
    if (i == frames / 3) {
      before = resident();
      state_before = tracker.state().size();
    }
  }
  EXPECT_EQ(lost, 0);
  EXPECT_LT(closed, 0.75 * drift) << "the loop of the first round is not closed";
  EXPECT_GT(tracker.keyframe_count(), 3 * options.keyframes);
  EXPECT_EQ(tracker.internals().keyframes.size(), options.keyframes);
  EXPECT_LT(resident(), before + (size_t{4} << 20) + 4000 * static_cast<size_t>(tracker.keyframe_count()));
  EXPECT_LE(tracker.internals().keyframes.archived().size(), 40u);
  // A pose and a few motions are kept of keyframes that are forgotten; sightings differ from window to window.
  EXPECT_LT(tracker.state().size(), state_before + 2500 * static_cast<size_t>(tracker.keyframe_count()) + 200000);
  std::printf("[          ] %d frames, %d keyframes, %zu MB\n", frames, tracker.keyframe_count(), resident() >> 20);
}

}  // namespace
}  // namespace iclk::test
