#pragma once
#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include <iclk/align/device_aligner.h>
#include <iclk/engine/error.h>
#include <iclk/render/procedural.h>
#include <iclk/render/renderer.h>
#include <iclk/track/tracker.h>
#include <iclk/track/trajectory.h>

#include "device.h"

namespace iclk::test {
namespace {

constexpr int kFrames = 24;

inline SE3 camera_pose(double frame) {
  Eigen::Matrix3d down;
  down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  const double a = 0.08 * frame;
  return {Eigen::AngleAxisd(0.5 * a, Eigen::Vector3d::UnitZ()).toRotationMatrix() * down *
              Eigen::AngleAxisd(0.05 * std::sin(3 * a), Eigen::Vector3d::UnitX()).toRotationMatrix(),
          Eigen::Vector3d(120 + 40 * std::cos(a), 120 + 40 * std::sin(a), 150 + 3 * std::sin(2 * a))};
}

/// Rendered once for all tests.
struct Flight {
  Camera camera{280, 280, 159.5, 119.5, 320, 240};
  std::vector<View> views;
  std::vector<SE3> truth;

  static const Flight& get() {
    static const Flight flight;
    return flight;
  }
  TrackFrame frame(int i) const {
    const View& view = views.at(static_cast<size_t>(i));
    return {0.1 * i, view.image(), view.depth_image(), {}};
  }

 private:
  Flight() {
    const auto terrain = std::make_shared<const Terrain>(procedural_terrain({.seed = 3, .size = 256}));
    TerrainRenderer renderer(device(), terrain);
    for (int i = 0; i < kFrames; ++i) {
      truth.push_back(camera_pose(i));
      views.push_back(renderer.render(camera, truth.back()));
    }
  }
};

inline TrackerOptions options_for() {
  TrackerOptions options;
  options.features = 100;
  options.depth_sigma = {.relative = 0.001};
  options.window = 4;
  options.keyframes = 12;
  return options;
}

struct Tracking {
  explicit Tracking(const TrackerOptions& options = options_for(), bool cpu = false)
      : aligner(make(options, cpu)), tracker(*aligner, Flight::get().camera, options) {}
  static std::unique_ptr<Aligner> make(const TrackerOptions& options, bool cpu) {
    AlignerOptions how;
    how.search = true;
    const Plan plan = Tracker::plan(Flight::get().camera, options);
    if (cpu) return make_cpu_aligner(plan, how);
    return make_device_aligner(device(), plan, how, Solver::device);
  }
  TrackResult track(const TrackFrame& frame) {
    results.push_back(tracker.track(frame));
    return results.back();
  }
  TrackResult track(int i) { return track(Flight::get().frame(i)); }
  /// m, of the frame's place in the map, by the keyframes' last poses; the map begins where frame `origin` was.
  double error(const TrackResult& r, int i, int origin = 0) const {
    const SE3 T_WC = tracker.keyframe_pose(r.keyframe) * r.T_CK.inverse();
    const SE3 truth = Flight::get().truth[static_cast<size_t>(origin)].inverse() * Flight::get().truth[static_cast<size_t>(i)];
    return (T_WC.t - truth.t).norm();
  }
  std::unique_ptr<Aligner> aligner;
  Tracker tracker;
  std::vector<TrackResult> results;
};

}  // namespace
}  // namespace iclk::test
