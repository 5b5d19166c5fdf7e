// What a turning camera whose rows are read one by one does to features, with truth.
#include <algorithm>
#include <cmath>
#include <random>

#include <gtest/gtest.h>
#include <Eigen/Cholesky>

#include <iclk/refine/internal/turn.h>
#include <iclk/refine/pose.h>

#include "bent_pair.h"

namespace iclk::test {
namespace {

using internal::estimate_turn;
using internal::pair_turn;
using internal::RollingSighting;
using internal::TurnEstimate;
using internal::unrolled;

const Camera kCamera{300, 300, 159.5, 119.5, 320, 240};

/// Of a turn, squared: 3 where the covariance is that of the errors.
double normalised_error(const TurnEstimate& found, const Eigen::Vector3d& turn) {
  const Eigen::Vector3d e = found.turn - turn;
  return e.dot(found.covariance.llt().solve(e));
}

/// Features of a reference that turned by turn_0 while its rows were read, in a target that turned by turn_1.
std::vector<RollingSighting> sightings_of(const Camera& camera, const RowTimes& rows, const SE3& T_10,
                                          const Eigen::Vector3d& turn_0, const Eigen::Vector3d& turn_1, double noise,
                                          std::mt19937_64& random) {
  std::uniform_real_distribution<double> u(20, 300), v(20, 220), q(0.1, 0.5);
  std::normal_distribution<double> normal;
  std::vector<RollingSighting> out;
  while (out.size() < 80) {
    RollingSighting s{{u(random), v(random)}, {}, q(random)};
    const Eigen::Vector3d X = rotation(turn_0 * rows.at(s.uv0)) * camera.ray(s.uv0);
    const Eigen::Vector3d p = T_10.R * X + s.inverse_depth * T_10.t;
    s.uv1 = camera.project(p);
    for (int i = 0; i < 20; ++i) s.uv1 = camera.project(rotation(-turn_1 * rows.at(s.uv1)) * p);
    s.uv1 += noise * Eigen::Vector2d(normal(random), normal(random));
    out.push_back(s);
  }
  return out;
}

TEST(RollingShutter, TurnsAreSeenInFeatures) {
  const RowTimes rows(kCamera);
  std::mt19937_64 random(3);
  const SE3 T_10 = SE3::exp((Vector6d() << 0.1, -0.05, 0.2, 0.03, -0.02, 0.04).finished());
  const Eigen::Vector3d turn_0(0.01, -0.02, 0.005), turn_1(-0.03, 0.02, 0.04);
  // From a pose that is off, as it is where the bend was taken for motion.
  const SE3 start = T_10 * SE3::exp((Vector6d() << 0.02, 0.01, -0.02, 0.004, -0.003, 0.005).finished());
  const auto exact = sightings_of(kCamera, rows, T_10, turn_0, turn_1, 0, random);
  const auto found = estimate_turn(kCamera, rows, start, turn_0, exact, 0.1, 1);
  ASSERT_TRUE(found);
  EXPECT_LT((found->turn - turn_1).norm(), 1e-5);
  EXPECT_GT((estimate_turn(kCamera, rows, start, Eigen::Vector3d::Zero(), exact, 0.1, 1)->turn - turn_1).norm(), 5e-3);

  double nees = 0;
  constexpr int kDraws = 100;
  for (int draw = 0; draw < kDraws; ++draw) {
    const auto noisy = sightings_of(kCamera, rows, T_10, turn_0, turn_1, 0.3, random);
    const auto one = estimate_turn(kCamera, rows, start, turn_0, noisy, 0.3, 1);
    ASSERT_TRUE(one);
    nees += normalised_error(*one, turn_1) / kDraws;
  }
  EXPECT_NEAR(nees, 3, 1);

  auto outliers = sightings_of(kCamera, rows, T_10, turn_0, turn_1, 0.3, random);
  for (size_t i = 0; i < 12; ++i) outliers[i].uv1 += Eigen::Vector2d(15, -20);
  EXPECT_LT((estimate_turn(kCamera, rows, start, turn_0, outliers, 0.3, 1)->turn - turn_1).norm(), 0.01);
  // A prior that knows better holds it; too few features say nothing.
  EXPECT_LT(estimate_turn(kCamera, rows, start, turn_0, outliers, 0.3, 1e-6)->turn.norm(), 1e-3);
  EXPECT_FALSE(estimate_turn(kCamera, rows, start, turn_0, std::span(exact).first(14), 0.3, 1));
}

TEST(RollingShutter, WhatIsWrongInDepthsIsAllowedFor) {
  const RowTimes rows(kCamera);
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  const SE3 T_10 = SE3::exp((Vector6d() << 0.3, -0.15, 0.2, 0.03, -0.02, 0.04).finished());
  const Eigen::Vector3d turn(-0.03, 0.02, 0.04);
  double nees = 0, trusting = 0, error = 0, trusting_error = 0;
  constexpr int kDraws = 100;
  for (int draw = 0; draw < kDraws; ++draw) {
    auto coarse = sightings_of(kCamera, rows, T_10, Eigen::Vector3d::Zero(), turn, 0.1, random);
    for (size_t i = 0; i < coarse.size(); ++i) {
      coarse[i].inverse_depth_sigma = i % 2 == 0 ? 0.03 : 0.003;
      coarse[i].inverse_depth += coarse[i].inverse_depth_sigma * normal(random);
    }
    const auto found = estimate_turn(kCamera, rows, T_10, Eigen::Vector3d::Zero(), coarse, 0.1, 1);
    for (RollingSighting& s : coarse) s.inverse_depth_sigma = 0;
    const auto without = estimate_turn(kCamera, rows, T_10, Eigen::Vector3d::Zero(), coarse, 0.1, 1);
    ASSERT_TRUE(found && without);
    nees += normalised_error(*found, turn) / kDraws;
    trusting += normalised_error(*without, turn) / kDraws;
    error += (found->turn - turn).norm() / kDraws;
    trusting_error += (without->turn - turn).norm() / kDraws;
  }
  EXPECT_NEAR(nees, 3, 1);
  EXPECT_GT(trusting, 6);
  EXPECT_LT(error, 0.8 * trusting_error);
}

TEST(RollingShutter, TurnsAreSeenInFeaturesOfAnImageWhoseLensWasUndone) {
  const RowTimes plain(kCamera), rows(kCamera, [&](const Eigen::Vector2d&uv) {
    return 0.9 * row_time(kCamera, uv.y()) + 4e-4 * (uv.x() - kCamera.cx);  // rows that lie aslant
  });
  std::mt19937_64 random(3);
  const SE3 T_10 = SE3::exp((Vector6d() << 0.1, -0.05, 0.2, 0.03, -0.02, 0.04).finished());
  const Eigen::Vector3d turn_0(0.01, -0.02, 0.005), turn_1(-0.03, 0.02, 0.04);
  const auto exact = sightings_of(kCamera, rows, T_10, turn_0, turn_1, 0, random);
  const auto found = estimate_turn(kCamera, rows, T_10, turn_0, exact, 0.1, 1);
  ASSERT_TRUE(found);
  EXPECT_LT((found->turn - turn_1).norm(), 1e-5);
  EXPECT_GT((estimate_turn(kCamera, plain, T_10, turn_0, exact, 0.1, 1)->turn - turn_1).norm(), 2e-3);
}

TEST(RollingShutter, PairIsStraightenedWhereItsFeaturesProveTheBend) {
  std::mt19937_64 random(11);
  const Eigen::Vector3d turn(0.009, 0.006, -0.008);  // 4 px at the first and the last row
  double nees = 0, bent_error = 0, error = 0;
  constexpr int kDraws = 40;
  for (int draw = 0; draw < kDraws; ++draw) {
    const BentPair pair(turn, 0.01, 0.2, random);
    const PoseResult bent = refine_pose(pair.camera, pair.features, pair.aligned, pair.T_10);
    const auto found = pair_turn(pair.camera, pair.features, pair.aligned, bent.T_10);
    ASSERT_TRUE(found && found->proven(pair.camera)) << draw;
    EXPECT_LT((found->turn - turn).norm(), 0.002) << draw;
    std::vector<AlignedFeature> straight = pair.aligned;
    for (AlignedFeature& f : straight) f.uv1 = unrolled(pair.camera, found->turn, f.uv1);
    const PoseResult pose = refine_pose(pair.camera, pair.features, straight, found->T_10);
    ASSERT_TRUE(pose.converged()) << pose.reason;
    EXPECT_GT(pose.inliers, bent.inliers);
    const Vector6d e = (pose.T_10.inverse() * pair.T_10).log();
    nees += e.dot((pose.covariance + found->pose_share).llt().solve(e)) / kDraws;
    bent_error += (bent.T_10.inverse() * pair.T_10).angle() / kDraws;
    error += (pose.T_10.inverse() * pair.T_10).angle() / kDraws;
  }
  EXPECT_LT(error, 0.4 * bent_error);
  EXPECT_GT(nees, 2);  // 6 where everything is Gaussian
  EXPECT_LT(nees, 9);
}

TEST(RollingShutter, WhatIsNotBentStaysAsItIs) {
  std::mt19937_64 random(13);
  for (int draw = 0; draw < 150; ++draw) {
    const double depth_error = draw % 3 == 0 ? 0 : draw % 3 == 1 ? 0.02 : 0.06;
    const BentPair pair(Eigen::Vector3d::Zero(), depth_error, draw % 2 == 0 ? 0 : 0.3, random);
    const auto found = pair_turn(pair.camera, pair.features, pair.aligned, pair.T_10);
    ASSERT_TRUE(found) << draw;
    EXPECT_FALSE(found->proven(pair.camera)) << draw;
  }
  // Nor what bends less than would matter, however sure that is.
  const BentPair little(Eigen::Vector3d(0.0009, 0, 0), 0, 0, random);
  EXPECT_FALSE(pair_turn(little.camera, little.features, little.aligned, little.T_10)->proven(little.camera));
  // Too few, and none.
  BentPair few(Eigen::Vector3d(0.02, 0, 0), 0, 0, random);
  for (size_t i = 14; i < few.aligned.size(); ++i) few.aligned[i].status = FeatureStatus::diverged;
  EXPECT_FALSE(pair_turn(few.camera, few.features, few.aligned, few.T_10));
  EXPECT_FALSE(pair_turn(few.camera, {}, {}, few.T_10));
}

TEST(RollingShutter, ABendThatIsNotProvenIsAllowedFor) {
  std::mt19937_64 random(19);
  std::vector<double> without, with;
  for (int draw = 0; draw < 60; ++draw) {
    const BentPair pair(Eigen::Vector3d(0.0015, -0.001, 0), 0, 0, random);  // 0.47 px at the first and the last row
    const PoseResult pose = refine_pose(pair.camera, pair.features, pair.aligned, pair.T_10);
    const auto found = pair_turn(pair.camera, pair.features, pair.aligned, pose.T_10);
    ASSERT_TRUE(found) << draw;
    if (found->proven(pair.camera)) continue;
    const Vector6d e = (pose.T_10.inverse() * pair.T_10).log();
    without.push_back(e.dot(pose.covariance.llt().solve(e)));
    with.push_back(e.dot((pose.covariance + found->doubt(pose.T_10)).llt().solve(e)));
  }
  ASSERT_GT(with.size(), 30u);
  const auto median = [](std::vector<double> values) {
    std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
    return values[values.size() / 2];
  };
  EXPECT_GT(median(without), 10);
  EXPECT_LT(median(with), 8);
  EXPECT_GT(median(with), 2);
}

}  // namespace
}  // namespace iclk::test
