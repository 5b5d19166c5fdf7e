// refine_pose.comp and refine_verdict.comp against refine_pose(), which Ceres solves in double precision.
#include <cmath>
#include <cstring>

#include <gtest/gtest.h>

#include <iclk/refine/internal/device_pose.h>
#include <iclk/refine/internal/reprojection.h>
#include <iclk/refine/internal/uncertainty.h>

#include "bent_pair.h"
#include "device.h"
#include "device_pose_cases.h"

namespace iclk {
namespace {

using test::Case;
using test::case_of;
using test::deep_scene;
using test::difference;
using test::motion;
using test::Outcome;
using test::run;
using test::Scene;

TEST(DevicePose, AgreesWithCeres) {
  ICLK_NEED_DEVICE();
  std::vector<Case> cases;
  for (const Scene& scene : {test::wide_scene(), deep_scene()})
    for (const auto& [count, sigma, outliers, depth] :
         {std::tuple{50, 0.05, 0.0, 0.0}, {200, 0.2, 0.3, 0.0}, {200, 0.02, 0.1, 0.01}, {12, 0.1, 0.0, 0.0}})
      cases.push_back(case_of(scene, count, sigma, outliers, static_cast<uint32_t>(7 + cases.size()), depth));
  for (size_t i = 0; i < cases.size(); i += 3) {  // some know their depths' sigma
    cases[i].features.inverse_depth_sigma.assign(cases[i].features.inverse_depth.size(), 0);
    for (size_t k = 0; k < cases[i].features.inverse_depth.size(); k += 2)
      cases[i].features.inverse_depth_sigma[k] = 0.02 * cases[i].features.inverse_depth[k];
  }
  for (Scene scene : {test::wide_scene(), deep_scene()}) {  // whose rows are reversed
    scene.camera.fy = -scene.camera.fy;
    cases.push_back(case_of(scene, 100, 0.05, 0.1, static_cast<uint32_t>(7 + cases.size())));
  }
  RefinerOptions options;
  options.rolling_shutter = false;
  const auto outcomes = run(cases, options);
  for (size_t i = 0; i < cases.size(); ++i) {
    SCOPED_TRACE(i);
    const Case& c = cases[i];
    const PoseResult expected = refine_pose(c.camera, c.features, c.aligned, c.T_10);
    ASSERT_TRUE(expected.converged()) << expected.reason;
    const Outcome& o = outcomes[i];
    EXPECT_EQ(o.info.status, static_cast<uint32_t>(Status::converged));
    EXPECT_EQ(o.info.refined, 1u);
    EXPECT_LT(motion(c, o.T_10, expected.T_10), 2e-3);
    EXPECT_NEAR(o.state.floor, expected.floor, 0.01 * expected.floor);
    EXPECT_NEAR(o.state.depth_sigma, expected.depth_sigma, 0.01 * expected.depth_sigma + 1e-6);
    EXPECT_NEAR(o.info.sigma, expected.sigma, 0.01 * expected.sigma);
    EXPECT_EQ(o.info.used, static_cast<uint32_t>(expected.used));
    EXPECT_NEAR(o.info.inliers, expected.inliers, 1);
    EXPECT_LT(difference(expected.covariance, o.covariance), 0.03);
    EXPECT_NEAR(o.info.correction, motion(c, c.T_10, expected.T_10), motion(c, c.T_10, expected.T_10));
    EXPECT_EQ(o.task.feature_count, static_cast<uint32_t>(c.features.size()));  // it moved, so there is another round
    EXPECT_LT(motion(c, o.T_10, test::unpack_pose(o.task.pose)), 1e-3);
  }
}

TEST(DevicePose, AGivenCameraIsBelieved) {
  ICLK_NEED_DEVICE();
  const Case c = case_of(deep_scene(), 80, 0.05, 0.1, 3);
  RefinerOptions options;
  options.rolling_shutter = false;
  for (const double sigma : {0.0, 0.4}) {
    options.pose.camera_sigma = sigma;
    const Matrix6d expected = refine_pose(c.camera, c.features, c.aligned, c.T_10, options.pose).covariance;
    EXPECT_LT(difference(expected, run({c}, options)[0].covariance), 0.03);
    EXPECT_GT(difference(expected, run({c})[0].covariance), 0.1);
  }
}

TEST(DevicePose, UnitsOfLengthDropOut) {
  ICLK_NEED_DEVICE();
  std::vector<Case> cases{case_of(test::wide_scene(), 80, 0.05, 0.1, 3, 0.01)};
  for (const double unit : {1e-3, 1e4}) {
    Case c = cases[0];
    for (double& q : c.features.inverse_depth) q /= unit;
    c.T_10.t *= unit;
    cases.push_back(c);
  }
  const auto outcomes = run(cases);
  for (size_t i = 1; i < cases.size(); ++i) {
    const double unit = i == 1 ? 1e-3 : 1e4;
    EXPECT_EQ(outcomes[i].info.status, static_cast<uint32_t>(Status::converged));
    EXPECT_LT((outcomes[i].T_10.t / unit - outcomes[0].T_10.t).norm(), 1e-3);
    Matrix6d covariance = outcomes[i].covariance;
    covariance.topRows<3>() /= unit;
    covariance.leftCols<3>() /= unit;
    EXPECT_LT(difference(outcomes[0].covariance, covariance), 0.01);
  }
}

TEST(DevicePose, TakesOutABendThatIsProven) {
  ICLK_NEED_DEVICE();
  std::mt19937_64 random(17);
  std::vector<Case> cases;
  for (const Eigen::Vector3d& turn :
       {Eigen::Vector3d(0.009, 0.006, -0.008), {0, 0.02, 0}, {-0.004, 0, 0.03}, {0.0018, 0, 0}, {0, 0, 0}}) {
    const test::BentPair pair(turn, 0.01, 0.2, random);
    cases.push_back({pair.camera, pair.features, pair.aligned, pair.T_10});
  }
  RefinerOptions global;
  global.rolling_shutter = false;
  const auto outcomes = run(cases), as_they_are = run(cases, global);
  for (size_t i = 0; i < cases.size(); ++i) {
    SCOPED_TRACE(i);
    const Case& c = cases[i];
    const PoseResult bent = refine_pose(c.camera, c.features, c.aligned, c.T_10);
    const auto found = internal::pair_turn(c.camera, c.features, c.aligned, bent.T_10);
    ASSERT_TRUE(found);
    ASSERT_EQ(found->proven(c.camera), i < 3);
    const Eigen::Vector3d turn(outcomes[i].info.turn[0], outcomes[i].info.turn[1], outcomes[i].info.turn[2]);
    EXPECT_EQ(outcomes[i].info.rounds, 1u);
    if (bent.converged()) {
      EXPECT_LT(motion(c, as_they_are[i].T_10, bent.T_10), 0.03);  // what does not fit has a flat minimum
    }
    EXPECT_EQ(as_they_are[i].info.turn[1], 0);
    if (!found->proven(c.camera)) {
      EXPECT_EQ(turn, Eigen::Vector3d::Zero());
      const Matrix6d expected = bent.covariance + found->doubt(bent.T_10);
      EXPECT_LT(difference(expected, outcomes[i].covariance), 0.03);
      if (i == 3) {
        EXPECT_GT(difference(expected, as_they_are[i].covariance), 0.2);
      }
      EXPECT_EQ(std::memcmp(outcomes[i].info.pose, as_they_are[i].info.pose, sizeof outcomes[i].info.pose), 0);
      continue;
    }
    EXPECT_LT((turn - found->turn).norm(), 2e-5);
    std::vector<AlignedFeature> straight = c.aligned;
    for (AlignedFeature& f : straight) f.uv1 = internal::unrolled(c.camera, found->turn, f.uv1);
    const PoseResult expected = refine_pose(c.camera, c.features, straight, found->T_10);
    EXPECT_LT(motion(c, outcomes[i].T_10, expected.T_10), 5e-3);
    EXPECT_NEAR(outcomes[i].info.inliers, expected.inliers, 1);
    EXPECT_LT(difference(expected.covariance + found->pose_share, outcomes[i].covariance), 0.03);
  }
}

// Up to six of ten depths are wrong by factors from a third to three: a descent alone loses some of these poses.
TEST(DevicePose, RightDepthsOutvoteWrongOnes) {
  ICLK_NEED_DEVICE();
  const Scene scene = deep_scene();
  constexpr double kNoise = 0.02;
  std::vector<Case> cases;
  for (const double share : {0.3, 0.5, 0.6})
    for (uint32_t seed = 0; seed < 12; ++seed) {
      Case c = case_of(scene, 100, kNoise, 0, 20 + seed);
      std::mt19937 random(seed);
      std::uniform_real_distribution<double> uniform(0, 1);
      for (size_t i = 0; i < 100; ++i) {
        double& q = c.features.inverse_depth[i];
        q *= 0.5 + 1.5 * uniform(random);  // no plane
        c.aligned[i].covariance = 1e-4 * Eigen::Matrix2d::Identity();
        c.aligned[i].uv1 = c.camera.project(scene.T_10 * (c.camera.ray(c.features.uv[i]) / q)) +
                           kNoise * Eigen::Vector2d(uniform(random), uniform(random));
        if (uniform(random) < share) q *= std::exp(std::log(3) * (2 * uniform(random) - 1));
      }
      c.T_10 = scene.T_10 * SE3::exp((Vector6d() << 1.8, -1.8, 1.2, 0.024, -0.024, 0.06).finished());
      cases.push_back(c);
    }
  RefinerOptions options;
  options.rolling_shutter = false;
  const auto outcomes = run(cases, options);
  for (size_t i = 0; i < cases.size(); ++i) {
    SCOPED_TRACE(i);
    const Case& c = cases[i];
    const PoseResult expected = refine_pose(c.camera, c.features, c.aligned, c.T_10);
    EXPECT_EQ(outcomes[i].state.status, static_cast<uint32_t>(expected.status));
    EXPECT_LT(motion(c, expected.T_10, scene.T_10), 0.1);
    SE3 found = test::unpack_pose(outcomes[i].state.pose);
    found.t /= internal::unit_of(c.features);
    EXPECT_LT(motion(c, found, expected.T_10), 5e-3);
  }
}

}  // namespace
}  // namespace iclk
