// refine_verdict.comp: what is refused, kept and refuted.
#include <cmath>

#include <gtest/gtest.h>
#include <iclk/refine/internal/uncertainty.h>

#include "device.h"
#include "device_pose_cases.h"

namespace iclk {
namespace {

using test::Case;
using test::case_of;
using test::difference;
using test::motion;
using test::Outcome;
using test::run;
using test::Scene;

TEST(DeviceVerdict, RefusesWhatTheHostRefuses) {
  ICLK_NEED_DEVICE();
  const Scene scene = test::wide_scene();
  std::vector<Case> cases;
  std::vector<Status> expected;
  cases.push_back(case_of(scene, 60, 0.1, 0, 1));  // nothing was found: its texture may have been hidden
  for (size_t i = 3; i < cases.back().aligned.size(); ++i) cases.back().aligned[i].status = FeatureStatus::bad_match;
  expected.push_back(Status::diverged);
  cases.push_back(case_of(scene, 60, 0.1, 0, 2));
  for (AlignedFeature& a : cases.back().aligned) a.status = FeatureStatus::low_texture;
  expected.push_back(Status::too_few_features);
  cases.push_back(case_of(scene, 60, 0.1, 1, 3));  // every position is wrong
  expected.push_back(Status::diverged);
  cases.push_back(case_of(scene, 60, 0.1, 0, 4));  // one place seen sixty times determines nothing
  for (size_t i = 1; i < 60; ++i) {
    cases.back().features.uv[i] = cases.back().features.uv[0];
    cases.back().features.inverse_depth[i] = cases.back().features.inverse_depth[0];
    cases.back().aligned[i] = cases.back().aligned[0];
  }
  expected.push_back(Status::degenerate);
  cases.push_back(case_of(scene, 60, 0.1, 0, 8));  // on one edge, 2 px wide
  for (size_t i = 0; i < 60; ++i) {
    Eigen::Vector2d& uv = cases.back().features.uv[i];
    uv.y() = 100 + 0.3 * uv.x() + 0.1 * static_cast<double>(i % 20);
    cases.back().features.inverse_depth[i] = 1 / scene.depth(uv);
    cases.back().aligned[i].uv1 = scene.truth(uv);
  }
  expected.push_back(Status::degenerate);
  cases.push_back(case_of(scene, 60, 0.1, 0, 5));  // 45 px from what ICLK found
  cases.back().T_10 = scene.T_10 * SE3::exp((Vector6d() << 0, 0, 0, 0.1, 0, 0).finished());
  expected.push_back(Status::diverged);
  cases.push_back(case_of(scene, 60, 0.1, 0, 6));  // NaN where it must not matter, and where it must
  cases.back().features.uv[0].x() = std::nan("");
  cases.back().aligned[1].uv1.x() = std::nan("");
  cases.back().aligned[2].covariance(0, 0) = std::nan("");
  expected.push_back(Status::converged);
  const auto outcomes = run(cases);
  for (size_t i = 0; i < cases.size(); ++i) {
    SCOPED_TRACE(i);
    // Where nothing is determined, rounding decides whether the descent ends or leaves: both are refused.
    const bool leaves = expected[i] == Status::degenerate && outcomes[i].info.status == static_cast<uint32_t>(Status::diverged);
    if (!leaves) {
      EXPECT_EQ(outcomes[i].info.status, static_cast<uint32_t>(expected[i]));
    }
    EXPECT_EQ(outcomes[i].info.refined, expected[i] == Status::converged ? 1u : 0u);
    EXPECT_TRUE(outcomes[i].covariance.allFinite());
    if (expected[i] == Status::converged) continue;
    EXPECT_TRUE(outcomes[i].covariance.isZero());
    EXPECT_LT(motion(cases[i], outcomes[i].T_10, cases[i].T_10), 1e-3);  // ICLK's
  }
  EXPECT_EQ(outcomes.back().info.used, 57u);
}

TEST(DeviceVerdict, UnconfirmedPosesKeepIclksCovarianceAndThatOfTheDepths) {
  ICLK_NEED_DEVICE();
  Case c = case_of(test::wide_scene(), 60, 0.1, 0, 1);
  for (AlignedFeature& a : c.aligned) a.status = FeatureStatus::bad_match;
  c.iclk_covariance = 1e-6 * Matrix6d::Identity();
  c.features.inverse_depth_sigma.assign(60, 0.01 * c.features.inverse_depth[0]);
  RefinerOptions options;
  options.keep_unconfirmed = true;
  const Outcome o = run({c}, options)[0];
  EXPECT_EQ(o.info.status, static_cast<uint32_t>(Status::converged));
  EXPECT_EQ(o.info.refined, 0u);
  const Matrix6d expected =
      c.iclk_covariance +
      internal::depth_covariance(c.camera, c.features, check_features(c.features, c.camera), c.T_10, 0, ICLK_MAP_SIGMA);
  EXPECT_GT(difference(expected, c.iclk_covariance), 0.1);
  EXPECT_LT(difference(expected, o.covariance), 0.02);
}

TEST(DeviceVerdict, FewFeaturesAreEnoughOnlyIfAskedAndIfNearlyAllAgree) {
  ICLK_NEED_DEVICE();
  Case clear = case_of(test::wide_scene(), 60, 0.1, 0, 1);
  for (size_t i = 0; i < 45; ++i) clear.aligned[i].status = FeatureStatus::bad_match;
  Case doubtful = clear;
  for (size_t i = 0; i < 3; ++i) doubtful.aligned[i].status = FeatureStatus::aligned, doubtful.aligned[i].uv1.x() += 40;
  for (const double share : {0.35, 0.2}) {
    RefinerOptions options;
    options.min_clear_share = share;
    const auto outcomes = run({clear, doubtful}, options);
    EXPECT_EQ(outcomes[0].info.refined, share < 0.3 ? 1u : 0u);
    EXPECT_EQ(outcomes[1].info.refined, 0u);
  }
}

/// 15 of 60 features are found, at the pose of the alignment.
Case hidden_but_15(const Scene& scene) {
  Case c = case_of(scene, 60, 0.1, 0, 1);
  for (size_t i = 0; i < 45; ++i) c.aligned[i].status = FeatureStatus::bad_match;
  c.T_10 = scene.T_10;
  return c;
}

// Enough were found, and most of them elsewhere: only a first guess may overrule that.
TEST(DeviceVerdict, FeaturesRefuteAPoseThatWasSearchedFor) {
  ICLK_NEED_DEVICE();
  const Scene scene = test::wide_scene();
  Case searched = case_of(scene, 60, 0.1, 0, 1);
  for (size_t i = 0; i < 45; ++i)
    searched.aligned[i].uv1 += Eigen::Vector2d(i % 2 ? 40 : -40, 7.0 * static_cast<double>(i) - 160);
  Case guessed = searched;
  guessed.search = false;
  Case elsewhere = hidden_but_15(scene);  // they agree on a pose 2 px away
  elsewhere.T_10 = elsewhere.T_10 * SE3::exp((Vector6d() << 0, 0, 0, 0.005, 0, 0).finished());
  RefinerOptions options;
  options.keep_unconfirmed = true;
  const auto outcomes = run({searched, guessed, elsewhere}, options);
  EXPECT_EQ(outcomes[0].info.status, static_cast<uint32_t>(Status::diverged));
  EXPECT_TRUE(outcomes[0].covariance.isZero());
  EXPECT_EQ(outcomes[1].info.status, static_cast<uint32_t>(Status::converged));
  EXPECT_EQ(outcomes[2].info.status, static_cast<uint32_t>(Status::diverged));
  for (const Outcome& o : outcomes) EXPECT_EQ(o.info.refined, 0u);
}

TEST(DeviceVerdict, FewFeaturesThatFindTheSamePoseAsAModelAreEnough) {
  ICLK_NEED_DEVICE();
  const Case found = hidden_but_15(test::wide_scene());
  Case guessed = found, scattered = found, split = found;
  guessed.search = false;
  for (size_t i = 45; i < 60; ++i) scattered.aligned[i].uv1 += Eigen::Vector2d(i % 2 ? 0.9 : -0.9, i % 4 < 2 ? 0.9 : -0.9);
  for (size_t i = 0; i < 13; ++i) split.aligned[i].status = FeatureStatus::aligned, split.aligned[i].uv1.x() += 40;
  RefinerOptions options;
  for (const bool model : {false, true}) {
    options.keep_unconfirmed = model;
    const auto outcomes = run({found, guessed, scattered, split}, options);
    EXPECT_EQ(outcomes[0].info.refined, model ? 1u : 0u);
    for (size_t i = 1; i < outcomes.size(); ++i) EXPECT_EQ(outcomes[i].info.refined, 0u) << i;
  }
}

}  // namespace
}  // namespace iclk
