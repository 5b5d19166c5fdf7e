// Pose and inverse depths of a rig from sightings of known errors: what comes out, and what is said of it.
#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <Eigen/Cholesky>
#include <Eigen/LU>

#include <iclk/engine/error.h>
#include <iclk/rig/adjust.h>
#include <iclk/rig/internal/common_pose.h>
#include <iclk/rig/rig.h>

namespace iclk {
namespace {

const Camera kLeft{300, 300, 159.5, 119.5, 320, 240}, kRight{340, 335, 170, 115, 340, 230};
const double kNaN = std::numeric_limits<double>::quiet_NaN();

SE3 true_pose() {
  Vector6d xi;
  xi << -0.5, 0.02, 0.01, 0.01, -0.02, 0.015;
  return SE3::exp(xi);
}

SE3 moved(const SE3& T, double translation, double rotation) {
  Vector6d xi;
  xi << -translation, translation, 0.5 * translation, rotation, -0.7 * rotation, 0.8 * rotation;
  return T * SE3::exp(xi);
}

/// `pairs` x 60 points 3 to 12 m away; sightings with noise of `sigma` px, inverse depths of `relative`.
std::vector<RigSighting> world(double sigma, double relative, unsigned seed = 1, int pairs = 6) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> u(20, 300), v(20, 220), z(3, 12);
  std::normal_distribution<double> normal(0, 1);
  std::vector<RigSighting> out;
  while (static_cast<int>(out.size()) < pairs * 60) {
    RigSighting s;
    s.pair = static_cast<int>(out.size()) / 60;
    s.left = {u(random), v(random)};
    const double q = 1 / z(random);
    s.right = kRight.project(true_pose() * (kLeft.ray(s.left) / q));
    if (!kRight.contains(s.right)) continue;
    s.right += sigma * Eigen::Vector2d(normal(random), normal(random));
    s.inverse_depth = q * (1 + relative * normal(random));
    s.inverse_depth_sigma = relative * q;
    out.push_back(s);
  }
  return out;
}

Vector6d error_of(const RigAdjustment& r) { return (r.T_rl.inverse() * true_pose()).log(); }

TEST(AdjustRig, ExactSightingsGiveTheExactPose) {
  std::vector<RigSighting> sightings = world(0, 0);
  for (RigSighting& s : sightings) s.inverse_depth_sigma = 1e-4 * s.inverse_depth;
  const RigAdjustment r = adjust_rig(kLeft, kRight, sightings, moved(true_pose(), 0.03, 0.03));
  ASSERT_TRUE(r.usable);
  EXPECT_LT(error_of(r).norm(), 1e-6);
  EXPECT_EQ(r.inliers, static_cast<int>(sightings.size()));
}

TEST(AdjustRig, UnknownDepthsAreFoundAndThePriorHoldsTheScale) {
  std::vector<RigSighting> sightings = world(0, 0);
  const std::vector<RigSighting> truth = sightings;
  std::mt19937 random(4);
  std::uniform_real_distribution<double> wrong(0.7, 1.3);
  for (RigSighting& s : sightings) s.inverse_depth *= wrong(random), s.inverse_depth_sigma = 0;
  RigAdjustOptions options;
  options.iterations = 200;
  options.baseline = true_pose().t.norm();
  options.baseline_sigma = 1e-3 * options.baseline;
  const RigAdjustment r = adjust_rig(kLeft, kRight, sightings, moved(true_pose(), 0.02, 0.02), options);
  ASSERT_TRUE(r.usable);
  EXPECT_LT(error_of(r).norm(), 1e-5);
  for (size_t i = 0; i < truth.size(); ++i) EXPECT_NEAR(r.inverse_depth[i] / truth[i].inverse_depth, 1, 1e-3) << i;
  // A prior of another length scales the world with it, and the rotation stays.
  options.baseline *= 1.2;
  options.baseline_sigma *= 1.2;
  const RigAdjustment longer = adjust_rig(kLeft, kRight, sightings, moved(true_pose(), 0.02, 0.02), options);
  ASSERT_TRUE(longer.usable);
  EXPECT_NEAR(longer.T_rl.t.norm(), options.baseline, 1e-6);
  EXPECT_LT((longer.T_rl.R.transpose() * true_pose().R - Eigen::Matrix3d::Identity()).norm(), 1e-5);
  // Without it nothing tells the length, and that is said.
  options.baseline_sigma = 0;
  EXPECT_FALSE(adjust_rig(kLeft, kRight, sightings, true_pose(), options).usable);
}

TEST(AdjustRig, CovarianceIsThatOfTheErrors) {
  for (const bool metric : {true, false}) {
    double sum = 0;
    const int draws = 40;
    for (int k = 0; k < draws; ++k) {
      std::vector<RigSighting> sightings = world(0.2, 0.02, 100 + static_cast<unsigned>(k));
      RigAdjustOptions options;
      options.shared_position = options.shared_depth = 0;  // these errors are independent
      std::mt19937 random(static_cast<unsigned>(k));
      if (!metric) {
        for (RigSighting& s : sightings) s.inverse_depth_sigma = 0;
        options.baseline_sigma = 2e-3;
        options.baseline = true_pose().t.norm() + options.baseline_sigma * std::normal_distribution<double>()(random);
      }
      const RigAdjustment r = adjust_rig(kLeft, kRight, sightings, true_pose(), options);
      ASSERT_TRUE(r.usable);
      const Vector6d e = error_of(r);
      sum += e.dot(r.covariance.ldlt().solve(e)) / 6 / draws;
      EXPECT_NEAR(r.sigma, 0.2, 0.05);
    }
    EXPECT_GT(sum, 0.55) << metric;  // 1, with deviation 0.09 over the draws; pairs that differ by chance widen a few
    EXPECT_LT(sum, 1.35) << metric;
  }
}

TEST(AdjustRig, ErrorsThatAPairSharesWidenTheCovariance) {
  double alone = 0, shared = 0;
  const int draws = 20, pairs = 20;
  for (int k = 0; k < draws; ++k) {
    std::vector<RigSighting> sightings = world(0.2, 0.02, 200 + static_cast<unsigned>(k), pairs);
    alone += adjust_rig(kLeft, kRight, sightings, true_pose()).inflation / draws;
    std::mt19937 random(static_cast<unsigned>(k));
    std::normal_distribution<double> normal(0, 0.2);
    std::vector<Eigen::Vector2d> off(pairs);
    for (Eigen::Vector2d& o : off) o = {normal(random), normal(random)};
    for (RigSighting& s : sightings) s.right += off[static_cast<size_t>(s.pair)];
    shared += adjust_rig(kLeft, kRight, sightings, true_pose()).inflation / draws;
  }
  EXPECT_LT(alone, 1.4);
  EXPECT_GT(shared, 3);
}

TEST(AdjustRig, ErrorsThatAllShareAreInTheCovariance) {
  // All depths too far by one deviation, all positions off by one: the error is one deviation of what was added.
  for (const bool depth : {true, false}) {
    std::vector<RigSighting> sightings = world(0, 0.01);
    const std::vector<RigSighting> exact = world(0, 0);
    for (size_t i = 0; i < sightings.size(); ++i) {
      sightings[i].inverse_depth = exact[i].inverse_depth;
      if (depth) sightings[i].inverse_depth -= 0.5 * sightings[i].inverse_depth_sigma;
      if (!depth) sightings[i].right += Eigen::Vector2d(0.1, 0);
    }
    RigAdjustOptions options;
    options.shared_position = depth ? 0 : 0.1;
    options.shared_depth = depth ? 0.5 : 0;
    const RigAdjustment r = adjust_rig(kLeft, kRight, sightings, true_pose(), options);
    ASSERT_TRUE(r.usable);
    const Vector6d e = error_of(r);
    Eigen::Index worst = 0;
    e.cwiseAbs().maxCoeff(&worst);
    EXPECT_NEAR(std::abs(e[worst]) / std::sqrt(r.covariance(worst, worst)), 1, 0.1) << depth;
  }
}

TEST(AdjustRig, WrongSightingsCostLittle) {
  std::vector<RigSighting> sightings = world(0.1, 0.01);
  for (size_t i = 0; i < sightings.size(); i += 5) sightings[i].right += Eigen::Vector2d(9, -14);
  for (size_t i = 2; i < sightings.size(); i += 50) sightings[i].right.x() = kNaN;
  for (size_t i = 3; i < sightings.size(); i += 50) sightings[i].inverse_depth = i % 2 ? kNaN : -1;
  const RigAdjustment r = adjust_rig(kLeft, kRight, sightings, moved(true_pose(), 0.02, 0.02));
  ASSERT_TRUE(r.usable);
  EXPECT_LT(error_of(r).tail<3>().norm(), 5e-4);
  EXPECT_LT(error_of(r).head<3>().norm(), 5e-3);
  EXPECT_TRUE(std::isinf(r.residual[2]));
}

TEST(AdjustRig, WhatCannotBeIsRefused) {
  const std::vector<RigSighting> sightings = world(0.1, 0.01);
  EXPECT_FALSE(adjust_rig(kLeft, kRight, {}, true_pose()).usable);
  EXPECT_FALSE(adjust_rig(kLeft, kRight, std::span(sightings).first(7), true_pose()).usable);
  SE3 nan = true_pose();
  nan.t.x() = kNaN;
  EXPECT_THROW(adjust_rig(kLeft, kRight, sightings, nan), Error);
  EXPECT_THROW(adjust_rig(Camera{}, kRight, sightings, true_pose()), Error);
  for (double RigAdjustOptions::*option : {&RigAdjustOptions::floor, &RigAdjustOptions::cauchy_scale,
                                           &RigAdjustOptions::baseline_sigma, &RigAdjustOptions::inlier_distance}) {
    RigAdjustOptions options;
    options.*option = kNaN;
    EXPECT_THROW(adjust_rig(kLeft, kRight, sightings, true_pose(), options), Error);
  }
}

TEST(Rectify, RowsOfTrueCorrespondencesAreEqual) {
  for (const RigSighting& s : world(0, 0.01)) {
    EXPECT_NEAR(rectified_error(kLeft, kRight, true_pose(), s.left, s.right), 0, 1e-9);
    // A pitch of 1 degree of the right camera is a row of f tan(1 degree).
    Vector6d pitch = Vector6d::Zero();
    pitch[3] = M_PI / 180;
    EXPECT_NEAR(std::abs(rectified_error(kLeft, kRight, SE3::exp(pitch) * true_pose(), s.left, s.right)), 5.2, 1.5);
  }
  const Rectification r = rectify(true_pose());
  EXPECT_NEAR(r.left.determinant(), 1, 1e-12);
  EXPECT_NEAR((r.right * true_pose().t).normalized().x(), -1, 1e-12);
}

TEST(CommonPose, AMinorityThatAgreesOnSomethingElseDoesNotMoveIt) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal(0, 1);
  std::vector<internal::PoseVote> votes;
  for (int i = 0; i < 15; ++i) {
    Vector6d xi;
    for (int k = 0; k < 6; ++k) xi[k] = 1e-3 * normal(random);
    const bool wrong = i % 3 == 1;
    votes.push_back({(wrong ? moved(true_pose(), 0.1, 0.05) : true_pose()) * SE3::exp(xi), 1e-6 * Matrix6d::Identity(), 0, 0});
  }
  const SE3 T = internal::common_pose(votes);
  EXPECT_LT((T.inverse() * true_pose()).log().norm(), 2e-3);
  for (size_t i = 0; i < votes.size(); ++i) EXPECT_EQ(votes[i].distance > 30, i % 3 == 1) << i << ": " << votes[i].distance;
}

TEST(CommonPose, IsTheSolutionOfTheSummedSystems) {
  // sum_i H_i (xi - xi_i) = 0 for small xi_i and information matrices that differ.
  std::mt19937 random(5);
  std::normal_distribution<double> normal(0, 1);
  std::vector<internal::PoseVote> votes;
  Matrix6d H = Matrix6d::Zero();
  Vector6d b = Vector6d::Zero();
  for (int i = 0; i < 5; ++i) {
    Matrix6d L;
    Vector6d xi;
    for (int k = 0; k < 36; ++k) L(k) = normal(random);
    for (int k = 0; k < 6; ++k) xi[k] = 1e-6 * normal(random);
    const Matrix6d C = L * L.transpose() + Matrix6d::Identity();
    votes.push_back({SE3::exp(xi), C, 0, 0});
    H += C.inverse();
    b += C.inverse() * xi;
  }
  EXPECT_LT((common_pose(votes).log() - H.ldlt().solve(b)).norm(), 1e-10);
}

TEST(ChiSquare, QuantilesOfTheTables) {
  EXPECT_NEAR(chi_square_quantile(6, 0.05), 12.592, 0.05);
  EXPECT_NEAR(chi_square_quantile(6, 0.001), 22.458, 0.25);
  EXPECT_NEAR(chi_square_quantile(1, 0.05), 3.841, 0.1);
  EXPECT_THROW(chi_square_quantile(0, 0.05), Error);
  EXPECT_THROW(chi_square_quantile(6, kNaN), Error);
}

}  // namespace
}  // namespace iclk
