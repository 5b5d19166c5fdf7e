// The whole way on images whose truth is exact: reliefs seen by a rig that was knocked.
#include <algorithm>
#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include <iclk/engine/error.h>
#include <iclk/rig/rig.h>

#include "relief.h"

namespace iclk::test {
namespace {

const SE3 kOld{Eigen::Matrix3d::Identity(), {-0.2, 0, 0}};

SE3 shocked() {
  Vector6d xi;
  xi << 0.004, -0.003, 0.002, 0.010, -0.008, 0.012;
  return kOld * SE3::exp(xi);
}

/// Reliefs that differ in texture, seen by the knocked rig; the last `strangers` by one that was knocked otherwise.
struct Scenes {
  std::vector<Relief> reliefs;
  std::vector<Frame> left, right;
  std::vector<RigPair> pairs;

  explicit Scenes(int count, int strangers = 0, const SE3& truth = shocked()) {
    Vector6d other;
    other << -0.02, 0.02, 0.01, -0.02, 0.015, 0.02;
    for (int i = 0; i < count; ++i) {
      Relief r;
      r.seed = static_cast<uint32_t>(11 + i);
      r.distance = 3 + 0.3 * i;
      r.noise = 0.005;
      r.T_10 = i < count - strangers ? truth : kOld * SE3::exp(other);
      reliefs.push_back(r);
      left.push_back(render(r, 0, static_cast<uint32_t>(i)));
      right.push_back(render(r, 1, static_cast<uint32_t>(i)));
    }
    for (size_t i = 0; i < reliefs.size(); ++i)
      pairs.push_back({left[i].view(), right[i].view(), random_features(reliefs[i], 60, static_cast<uint32_t>(i)), {}});
  }
  const Camera& camera() const { return reliefs.front().camera; }
};

std::unique_ptr<Aligner> aligner_for(const Scenes& scenes, int batch) {
  Plan plan = rig_plan(scenes.camera(), 60, batch);
  plan.format = PixelFormat::r32f;
  AlignerOptions options;
  options.levels = 3;
  return make_cpu_aligner(plan, options);
}

double degrees(const SE3& a, const SE3& b) { return (a.inverse() * b).angle() * 180 / M_PI; }

TEST(Rig, AShockIsFoundBySixPairsTogether) {
  const Scenes scenes(6, 1);
  const auto aligner = aligner_for(scenes, 4);  // smaller than the batch
  const RigResult r = estimate_rig(*aligner, scenes.camera(), scenes.pairs, kOld);
  ASSERT_TRUE(r.usable) << r.reason;
  EXPECT_LT(degrees(r.T_rl, shocked()), 0.04);  // 0.1 px
  EXPECT_LT((r.T_rl.t - shocked().t).norm(), 2.5e-3);
  EXPECT_TRUE(r.moved);
  EXPECT_FALSE(r.scale_from_prior);
  EXPECT_GT(r.epipolar_before, 1);
  EXPECT_LT(r.epipolar_after, 0.1);
  EXPECT_EQ(r.pairs_used, 5);
  EXPECT_FALSE(r.pairs.back().used) << r.pairs.back().distance;  // the stranger
  const Vector6d e = (r.T_rl.inverse() * shocked()).log();
  for (int k = 0; k < 6; ++k) EXPECT_LT(std::abs(e[k]), 5 * std::sqrt(r.covariance(k, k))) << k;
}

TEST(Rig, OneThatHasNotMovedIsSaidToStand) {
  const Scenes scenes(3, 0, kOld);
  const auto aligner = aligner_for(scenes, 3);
  const RigResult r = estimate_rig(*aligner, scenes.camera(), scenes.pairs, kOld);
  ASSERT_TRUE(r.usable) << r.reason;
  EXPECT_FALSE(r.moved) << r.chi_square;
  EXPECT_LT(degrees(r.T_rl, kOld), 0.04);
}

TEST(Rig, WithoutMetricDepthsTheBaselineKeepsItsLength) {
  Scenes scenes(4);
  for (RigPair& p : scenes.pairs)
    for (double& q : p.features.inverse_depth) q *= 1.1;
  const auto aligner = aligner_for(scenes, 4);
  RigOptions options;
  options.metric = false;
  const RigResult r = estimate_rig(*aligner, scenes.camera(), scenes.pairs, kOld, options);
  ASSERT_TRUE(r.usable) << r.reason;
  EXPECT_TRUE(r.scale_from_prior);
  EXPECT_NE(r.reason.find("scale from the old calibration"), std::string::npos);
  EXPECT_NEAR(r.T_rl.t.norm(), 0.2, 1e-3);
  EXPECT_LT(degrees(r.T_rl, shocked()), 0.15);
  EXPECT_LT(r.epipolar_after, 0.15);
}

TEST(Rig, BlankImagesGiveNoPoseAndSayWhy) {
  Scenes scenes(2);
  for (Frame& f : scenes.right) std::fill(f.data.begin(), f.data.end(), 0.5f);
  const auto aligner = aligner_for(scenes, 2);
  const RigResult r = estimate_rig(*aligner, scenes.camera(), scenes.pairs, kOld);
  EXPECT_FALSE(r.usable);
  EXPECT_FALSE(r.reason.empty());
  EXPECT_EQ(r.T_rl.t, kOld.t);
}

TEST(Rig, WhatCannotBeIsRefused) {
  const Scenes scenes(1);
  const auto aligner = aligner_for(scenes, 1);
  EXPECT_THROW(estimate_rig(*aligner, scenes.camera(), {}, kOld), Error);
  EXPECT_THROW(estimate_rig(*aligner, scenes.camera(), scenes.pairs, SE3{}), Error);  // no baseline
  SE3 nan = kOld;
  nan.R(1, 1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(estimate_rig(*aligner, scenes.camera(), scenes.pairs, nan), Error);
  RigOptions options;
  options.false_alarm = 0;
  EXPECT_THROW(estimate_rig(*aligner, scenes.camera(), scenes.pairs, kOld, options), Error);
  options = {};
  options.depth_sigma = -1;
  EXPECT_THROW(estimate_rig(*aligner, scenes.camera(), scenes.pairs, kOld, options), Error);
  Camera wrong = scenes.camera();
  wrong.width = 100;
  EXPECT_THROW(estimate_rig(*aligner, wrong, scenes.pairs, kOld), Error);
}

}  // namespace
}  // namespace iclk::test
