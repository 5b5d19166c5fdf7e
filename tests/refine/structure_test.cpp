#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <iclk/engine/error.h>
#include <iclk/refine/internal/structure.h>
#include <Eigen/Cholesky>

#include "correspondences.h"

namespace iclk {
namespace {

using internal::refine_structure;
using internal::StructureOptions;
using internal::StructureResult;
using test::correspondences;
using test::Scene;
using test::wide_scene;

Vector6d error_of(const SE3& estimate, const SE3& truth) { return (estimate.inverse() * truth).log(); }

TEST(Structure, WrongDepthsAreMendedAndTheCovarianceIsHonest) {
  const Scene scene = wide_scene();
  const double relative = 0.05, sigma = 0.1;
  std::mt19937 random(3);
  std::normal_distribution<double> normal(0, 1);
  double pose_before = 0, pose_after = 0, q_before = 0, q_after = 0, nees = 0, q_nees = 0;
  int runs = 0, n = 50;
  for (int run = 0; run < 60; ++run) {
    Features f = test::random_features(scene, n, 100 + run);
    const std::vector<AlignedFeature> a = correspondences(scene, f, sigma, random);
    const std::vector<double> truth = f.inverse_depth;
    for (double& q : f.inverse_depth) q *= 1 + relative * normal(random);
    StructureOptions options;
    options.relative_sigma = relative;
    const PoseResult pose = refine_pose(scene.camera, f, a, scene.T_10);
    const StructureResult r = refine_structure(scene.camera, f, a, scene.T_10, options);
    if (!r.pose.converged()) continue;
    ++runs;
    const Vector6d e = error_of(r.pose.T_10, scene.T_10);
    pose_before += error_of(pose.T_10, scene.T_10).squaredNorm();
    pose_after += e.squaredNorm();
    nees += e.dot(r.pose.covariance.ldlt().solve(e)) / 6;
    for (int i = 0; i < n; ++i) {
      q_before += std::pow(f.inverse_depth[i] / truth[i] - 1, 2);
      q_after += std::pow(r.inverse_depth[i] / truth[i] - 1, 2);
      q_nees += std::pow((r.inverse_depth[i] - truth[i]) / r.inverse_depth_sigma[i], 2) / n;
    }
  }
  ASSERT_GT(runs, 55);
  RecordProperty("nees", std::to_string(nees / runs));
  RecordProperty("q_nees", std::to_string(q_nees / runs));
  EXPECT_LT(q_after, 0.25 * q_before);  // variance
  EXPECT_LT(pose_after, 0.25 * pose_before);
  EXPECT_GT(nees / runs, 0.6);
  EXPECT_LT(nees / runs, 1.3);
  EXPECT_GT(q_nees / runs, 0.6);
  EXPECT_LT(q_nees / runs, 1.3);
}

TEST(Structure, WithoutParallaxThePriorStands) {
  Scene scene = wide_scene();
  scene.T_10.t.setZero();
  std::mt19937 random(1);
  Features f = test::random_features(scene, 30, 1);
  const std::vector<AlignedFeature> a = correspondences(scene, f, 0.05, random);
  f.inverse_depth_sigma.assign(30, 1e-4);
  const StructureResult r = refine_structure(scene.camera, f, a, scene.T_10);
  ASSERT_TRUE(r.pose.converged()) << r.pose.reason;
  for (int i = 0; i < 30; ++i) {
    EXPECT_NEAR(r.inverse_depth[i], f.inverse_depth[i], 2e-5);
    EXPECT_NEAR(r.inverse_depth_sigma[i], 1e-4, 2e-5);
  }
}

TEST(Structure, ASigmaOfTheFeatureBeatsTheDefault) {
  const Scene scene = wide_scene();
  std::mt19937 random(1);
  Features f = test::random_features(scene, 30, 1);
  const std::vector<AlignedFeature> a = correspondences(scene, f, 0.01, random);
  const double truth = f.inverse_depth[7];
  f.inverse_depth[7] *= 1.04;
  f.inverse_depth_sigma.resize(30, 1e-9 * truth);  // all known for certain but one
  f.inverse_depth_sigma[7] = 0.1 * truth;
  const StructureResult r = refine_structure(scene.camera, f, a, scene.T_10);
  ASSERT_TRUE(r.pose.converged()) << r.pose.reason;
  EXPECT_NEAR(r.inverse_depth[7], truth, 0.01 * truth);
  EXPECT_NEAR(r.inverse_depth[8], f.inverse_depth[8], 1e-6 * truth);
}

TEST(Structure, WhatIsNotDeterminedIsAStatusAndNothingIsPrinted) {
  const Scene scene = wide_scene();
  std::mt19937 random(1);
  Features f = test::random_features(scene, 30, 1);
  const std::vector<AlignedFeature> a = correspondences(scene, f, 0.05, random);
  for (const double q : f.inverse_depth) f.inverse_depth_sigma.push_back(1e18 * q);  // nothing tells the scale
  testing::internal::CaptureStderr();
  const StructureResult r = refine_structure(scene.camera, f, a, scene.T_10);
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
  EXPECT_EQ(r.pose.status, Status::degenerate) << r.pose.reason;
  EXPECT_TRUE(r.pose.covariance.isZero());
}

TEST(Structure, HostileInput) {
  const Scene scene = wide_scene();
  std::mt19937 random(1);
  Features f = test::random_features(scene, 30, 1);
  f.uv[2].x() = std::numeric_limits<double>::quiet_NaN();
  f.inverse_depth[3] = -1;
  f.inverse_depth_sigma.assign(30, std::numeric_limits<double>::quiet_NaN());  // unknown: the default stands in
  const std::vector<AlignedFeature> a = correspondences(scene, f, 0.05, random);
  const StructureResult r = refine_structure(scene.camera, f, a, scene.T_10);
  ASSERT_TRUE(r.pose.converged()) << r.pose.reason;
  EXPECT_EQ(r.pose.used, 28);
  EXPECT_EQ(r.inverse_depth[3], -1);
  EXPECT_EQ(r.inverse_depth_sigma[3], 0);
  EXPECT_GT(r.inverse_depth_sigma[4], 0);

  std::vector<AlignedFeature> none(30);
  const StructureResult empty = refine_structure(scene.camera, f, none, scene.T_10);
  EXPECT_EQ(empty.pose.status, Status::too_few_features);
  EXPECT_EQ(empty.inverse_depth.size(), 30u);
  StructureOptions options;
  options.relative_sigma = 0;
  EXPECT_THROW(refine_structure(scene.camera, f, a, scene.T_10, options), Error);
}

}  // namespace
}  // namespace iclk
