// Poses and depths together: what was disturbed comes back, and only what the sightings say.
#include <random>

#include <gtest/gtest.h>

#include <iclk/track/internal/bundle.h>

namespace iclk::internal {
namespace {

const Camera kCamera{300, 300, 159.5, 119.5, 320, 240};

/// Four cameras that look at points 2 to 4 m away; every point is a feature of one of them and seen by all.
struct World {
  std::vector<BundleFrame> frames;
  std::vector<SE3> truth;
  std::vector<std::vector<double>> depths;
  std::vector<BundleSighting> sightings;

  explicit World(double noise = 0) {
    std::mt19937 random(1);
    std::uniform_real_distribution<double> u(40, 280), v(40, 200), z(2, 4);
    std::normal_distribution<double> normal(0, 1);
    for (int i = 0; i < 4; ++i) {
      Vector6d xi;
      xi << 0.15 * i, 0.05 * i * (i % 2 ? 1 : -1), 0.03 * i, 0.01 * i, -0.02 * i, 0.03 * i;
      truth.push_back(SE3::exp(xi));
      BundleFrame frame{.T_WC = truth.back()};
      for (int k = 0; k < 40; ++k) {
        frame.uv.emplace_back(u(random), v(random));
        frame.inverse_depth.push_back(1 / z(random));
      }
      frame.prior = frame.inverse_depth;
      frame.prior_sigma.assign(frame.uv.size(), 0.01);
      depths.push_back(frame.inverse_depth);
      frames.push_back(frame);
    }
    for (int i = 0; i < 4; ++i)
      for (int k = 0; k < 40; ++k)
        for (int j = 0; j < 4; ++j) {
          if (i == j) continue;
          const auto a = static_cast<size_t>(i), b = static_cast<size_t>(k);
          const Eigen::Vector3d X =
              truth[static_cast<size_t>(j)].inverse() * (truth[a] * (kCamera.ray(frames[a].uv[b]) / depths[a][b]));
          const Eigen::Vector2d uv = kCamera.project(X) + noise * Eigen::Vector2d(normal(random), normal(random));
          if (kCamera.contains(uv)) sightings.push_back({i, k, j, uv, 0.01 * Eigen::Matrix2d::Identity()});
        }
    frames[0].fixed = true;
  }
  void disturb(double pose, double depth) {
    std::mt19937 random(2);
    std::normal_distribution<double> normal(0, 1);
    for (size_t i = 1; i < 4; ++i) {
      Vector6d xi;
      for (int k = 0; k < 6; ++k) xi[k] = pose * normal(random);
      frames[i].T_WC = frames[i].T_WC * SE3::exp(xi);
      for (double& q : frames[i].inverse_depth) q *= 1 + depth * normal(random);
    }
  }
  double pose_error() const {
    double most = 0;
    for (size_t i = 0; i < 4; ++i) most = std::max(most, (frames[i].T_WC.inverse() * truth[i]).log().norm());
    return most;
  }
};

TEST(Bundle, WhatWasDisturbedComesBack) {
  World world;
  world.disturb(0.03, 0.05);
  for (BundleFrame& frame : world.frames) frame.prior_sigma.assign(frame.uv.size(), 0);  // the sightings alone, but frame 0's
  ASSERT_GT(world.pose_error(), 0.03);
  const BundleResult result = adjust(kCamera, world.frames, world.sightings, {}, {.iterations = 50});
  EXPECT_TRUE(result.usable);
  EXPECT_EQ(result.sightings, static_cast<int>(world.sightings.size()));
  EXPECT_LT(result.cost, 1e-3 * result.initial_cost);
  EXPECT_LT(world.pose_error(), 1e-4);
  for (size_t i = 0; i < 4; ++i)
    for (size_t k = 0; k < 40; ++k) EXPECT_NEAR(world.frames[i].inverse_depth[k] / world.depths[i][k], 1, 1e-3);
}

TEST(Bundle, NoiseAndOutliersCostLittle) {
  World world(0.2);
  for (size_t k = 0; k < world.sightings.size(); k += 12) world.sightings[k].uv += Eigen::Vector2d(15, -9);
  world.disturb(0.03, 0.02);
  EXPECT_TRUE(adjust(kCamera, world.frames, world.sightings, {}, {.iterations = 50}).usable);
  EXPECT_LT(world.pose_error(), 2e-3);
}

TEST(Bundle, FixedFramesStay) {
  World world;
  world.disturb(0.02, 0);
  world.frames[2].fixed = true;
  const SE3 before = world.frames[2].T_WC;
  const std::vector<double> depth = world.frames[2].inverse_depth;
  EXPECT_TRUE(adjust(kCamera, world.frames, world.sightings).usable);
  EXPECT_EQ(world.frames[2].T_WC.t, before.t);
  EXPECT_EQ(world.frames[2].inverse_depth, depth);
  EXPECT_EQ(world.frames[0].T_WC.t, Eigen::Vector3d::Zero());
}

TEST(Bundle, AnEdgeHoldsWhatNothingElseDoes) {
  World world;
  std::erase_if(world.sightings, [](const BundleSighting& s) { return s.frame == 3 || s.seen_in == 3; });
  world.disturb(0.05, 0);
  Matrix6d covariance = Matrix6d::Zero();
  covariance.diagonal() << 1e-4, 2e-4, 3e-4, 1e-5, 2e-5, 3e-5;
  const BundleEdge edge{1, 3, world.truth[3].inverse() * world.truth[1], covariance};
  EXPECT_TRUE(adjust(kCamera, world.frames, world.sightings, {&edge, 1}, {.iterations = 50}).usable);
  EXPECT_LT(world.pose_error(), 1e-4);
  // Edges alone, and no frame that is fixed: the first one holds the world.
  World alone;
  alone.frames[0].fixed = false;
  alone.disturb(0.1, 0);
  std::vector<BundleEdge> edges;
  for (int i = 0; i < 3; ++i)
    edges.push_back(
        {i, i + 1, alone.truth[static_cast<size_t>(i) + 1].inverse() * alone.truth[static_cast<size_t>(i)], covariance});
  EXPECT_TRUE(adjust(kCamera, alone.frames, {}, edges, {.iterations = 50}).usable);
  EXPECT_LT(alone.pose_error(), 1e-4);
}

TEST(Bundle, ThePriorIsWeighedAgainstTheSightings) {
  // Two cameras at one place: sightings say nothing of depth, and it stays as it was measured.
  std::vector<BundleFrame> frames(2);
  std::vector<BundleSighting> sightings;
  frames[0].fixed = true;
  frames[1].uv = {{100, 100}, {200, 120}, {150, 180}, {60, 200}};
  frames[1].inverse_depth = {0.5, 0.4, 0.3, 0.6};
  frames[1].prior = {0.45, 0.4, 0.3, 0.6};
  frames[1].prior_sigma.assign(4, 0.02);
  for (int k = 0; k < 4; ++k)
    sightings.push_back({1, k, 0, frames[1].uv[static_cast<size_t>(k)], 0.01 * Eigen::Matrix2d::Identity()});
  EXPECT_TRUE(adjust(kCamera, frames, sightings, {}, {.iterations = 50}).usable);
  EXPECT_NEAR(frames[1].inverse_depth[0], 0.45, 1e-4);
}

TEST(Bundle, NothingIsNothing) {
  World world;
  EXPECT_FALSE(adjust(kCamera, {}, {}).usable);
  EXPECT_FALSE(adjust(kCamera, world.frames, {}).usable);
  for (BundleSighting& s : world.sightings) s.uv.x() = NAN;
  EXPECT_FALSE(adjust(kCamera, world.frames, world.sightings).usable);
}

}  // namespace
}  // namespace iclk::internal
