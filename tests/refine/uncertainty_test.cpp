// Errors that the patches know nothing of: of depth, of the camera. The covariance is judged by the errors that it states.
#include <gtest/gtest.h>

#include <random>

#include <Eigen/Cholesky>

#include <iclk/engine/error.h>
#include <iclk/refine/cascade.h>
#include <iclk/refine/internal/uncertainty.h>
#include <iclk/refine/pose.h>

#include "relief.h"

namespace iclk {
namespace {

const Camera kCamera{450, 450, 319.5, 239.5, 640, 480};

/// Points at 1 to 10, a motion that moves the nearest by some 80 px.
struct Observed {
  Features features;
  std::vector<AlignedFeature> aligned;
  SE3 T_10;
};

struct Noise {
  double position = 0.05;  ///< px
  double depth = 0;        ///< relative
  Eigen::Vector2d principal_point{0, 0};
};

Observed observe(int n, const Noise& noise, uint32_t seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal(0, 1);
  std::uniform_real_distribution<double> uniform(0, 1);
  Observed o;
  Vector6d xi;
  xi << 0.15 + 0.05 * normal(random), 0.05 * normal(random), 0.1 * normal(random), 0.02 * normal(random), 0.02 * normal(random),
      0.03;
  o.T_10 = SE3::exp(xi);
  Camera truth = kCamera;
  truth.cx += noise.principal_point.x();
  truth.cy += noise.principal_point.y();
  while (o.features.size() < n) {
    const Eigen::Vector2d uv(20 + 600 * uniform(random), 20 + 440 * uniform(random));
    const double q = std::pow(10, -uniform(random));
    const Eigen::Vector3d X1 = o.T_10 * Eigen::Vector3d(truth.ray(uv) / q);
    o.features.uv.push_back(uv);
    o.features.inverse_depth.push_back(q * (1 + noise.depth * normal(random)));
    AlignedFeature a;
    a.status = FeatureStatus::aligned;
    a.uv1 = truth.project(X1) + noise.position * Eigen::Vector2d(normal(random), normal(random));
    o.aligned.push_back(a);
  }
  return o;
}

/// Squared errors by the stated covariance: their mean over 6, which is 1 where the covariance is right, and the root mean
/// square of the rotation's.
struct Judged {
  double nees = 0, rotation = 0;
};
Judged judge(int n, const Noise& noise, bool sigma_given, const PoseOptions& options = {}, bool with_shared = true) {
  constexpr int kRuns = 150;
  Judged out;
  for (uint32_t seed = 0; seed < kRuns; ++seed) {
    Observed o = observe(n, noise, seed);
    if (sigma_given)
      for (double q : o.features.inverse_depth) o.features.inverse_depth_sigma.push_back(noise.depth * q);
    const PoseResult r = refine_pose(kCamera, o.features, o.aligned, o.T_10, options);
    EXPECT_TRUE(r.converged()) << r.reason;
    const Vector6d e = (r.T_10.inverse() * o.T_10).log();
    const Matrix6d C = with_shared ? r.covariance : Matrix6d(r.covariance - r.shared);
    out.nees += e.dot(C.ldlt().solve(e)) / 6 / kRuns;
    out.rotation += e.tail<3>().squaredNorm() / kRuns;
  }
  out.rotation = std::sqrt(out.rotation);
  return out;
}

TEST(Uncertainty, DepthErrorsAreInTheCovariance) {
  PoseOptions blind;
  blind.max_depth_sigma = 0;
  for (const int n : {50, 200}) {
    SCOPED_TRACE(testing::Message() << n << " features");
    const Noise noise{.depth = 0.015};
    // These errors are independent: the part for shared ones is left out first, and makes it a cautious one then.
    const Judged without = judge(n, noise, false, blind, false), estimated = judge(n, noise, false, {}, false),
                 given = judge(n, noise, true, {}, false);
    EXPECT_GT(without.nees, 1.6);
    for (const Judged& known : {estimated, given}) {
      EXPECT_LT(known.nees, 1.25);
      EXPECT_GT(known.nees, 0.7);
    }
    EXPECT_GT(judge(n, noise, false).nees, 0.3);
    EXPECT_LT(estimated.rotation, 0.8 * without.rotation) << "what depth does not reach counts for more";
    EXPECT_LT(given.rotation, 0.8 * without.rotation);
  }
}

TEST(Uncertainty, DepthsWithoutErrorsCostLittle) {
  PoseOptions blind;
  blind.max_depth_sigma = 0;
  const Judged without = judge(100, {}, false, blind), estimated = judge(100, {}, false);
  EXPECT_LT(estimated.rotation, 1.05 * without.rotation);
  EXPECT_GT(estimated.nees, 0.5);
}

TEST(Uncertainty, TheEstimateIsThatOfTheDepths) {
  double sum = 0, none = 0;
  for (uint32_t seed = 0; seed < 20; ++seed) {
    const Observed o = observe(200, {.depth = 0.01}, seed), exact = observe(200, {}, seed);
    sum += refine_pose(kCamera, o.features, o.aligned, o.T_10).depth_sigma / 20;
    none += refine_pose(kCamera, exact.features, exact.aligned, exact.T_10).depth_sigma / 20;
  }
  EXPECT_NEAR(sum, 0.01, 0.002);
  EXPECT_LT(none, 0.001);
}

// A feature that says that its depth is not known still holds the pose, across its epipolar line; one that is certain of a
// wrong depth is believed.
TEST(Uncertainty, TheFeaturesOwnSigmasCount) {
  Observed o = observe(60, {}, 4);
  o.features.inverse_depth_sigma.assign(60, 1e-6);
  const PoseResult certain = refine_pose(kCamera, o.features, o.aligned, o.T_10);
  for (size_t i = 0; i < 60; ++i) o.features.inverse_depth_sigma[i] = 0.5 * o.features.inverse_depth[i];
  const PoseResult vague = refine_pose(kCamera, o.features, o.aligned, o.T_10);
  ASSERT_TRUE(certain.converged() && vague.converged());
  EXPECT_GT(vague.covariance.diagonal()[0], 20 * certain.covariance.diagonal()[0]);
  EXPECT_EQ(certain.depth_sigma, 0) << "nothing is left to estimate";

  o.features.inverse_depth_sigma.assign(60, 1e-6);
  for (size_t i = 0; i < 20; ++i) {
    o.features.inverse_depth[i] *= 1.02;
    o.features.inverse_depth_sigma[i] = 0.02 * o.features.inverse_depth[i];
  }
  const PoseResult said = refine_pose(kCamera, o.features, o.aligned, o.T_10);
  const double error = (said.T_10.inverse() * o.T_10).log().head<3>().norm();
  o.features.inverse_depth_sigma.clear();
  const PoseResult unsaid = refine_pose(kCamera, o.features, o.aligned, o.T_10);
  EXPECT_LT(error, (unsaid.T_10.inverse() * o.T_10).log().head<3>().norm());
}

// Half a pixel between the camera and what is said of it.
TEST(Uncertainty, AWrongPrincipalPointIsAllowedFor) {
  const Noise noise{.principal_point = {0.5, -0.5}};
  EXPECT_GT(judge(150, noise, false, {}, false).nees, 3) << "by independent errors alone";
  EXPECT_LT(judge(150, noise, false).nees, 1.5);
  const Observed wrong = observe(150, noise, 1), right = observe(150, {}, 1);
  const double allowed = refine_pose(kCamera, wrong.features, wrong.aligned, wrong.T_10).calibration_sigma;
  EXPECT_GT(allowed, 0.15);
  EXPECT_LT(allowed, 1.5);
  EXPECT_LT(refine_pose(kCamera, right.features, right.aligned, right.T_10).calibration_sigma, 0.3);
}

// What the caller knows of the camera stands in the place of what residuals allow for.
TEST(Uncertainty, AGivenCameraIsBelieved) {
  PoseOptions exact, vague;
  exact.camera_sigma = 0;
  vague.camera_sigma = 0.5;
  const double known = judge(150, {}, false, exact).nees;
  EXPECT_GT(known, judge(150, {}, false).nees);
  EXPECT_NEAR(known, 1, 0.25);
  EXPECT_GT(judge(150, {.principal_point = {0.5, -0.5}}, false, exact).nees, 3);
  EXPECT_LT(judge(150, {.principal_point = {0.5, -0.5}}, false, vague).nees, 1);
  vague.camera_sigma = -1;
  EXPECT_THROW(vague.check(), Error);
}

TEST(Uncertainty, AShiftOfAllPositionsIsAllowedFor) {
  Observed o = observe(150, {.position = 0}, 1);
  for (AlignedFeature& a : o.aligned) {
    if (!kCamera.contains(a.uv1)) a.status = FeatureStatus::out_of_image;
    a.uv1 += Eigen::Vector2d(0.3, -0.3);
  }
  PoseOptions exact;
  exact.camera_sigma = exact.max_depth_sigma = 0;
  exact.cauchy_scale = 1e4;
  const PoseResult r = refine_pose(kCamera, o.features, o.aligned, o.T_10, exact);
  const std::vector<FeatureCheck> checks(o.features.uv.size(), FeatureCheck::ok);
  const Matrix6d shifted = internal::shift_covariance(kCamera, o.features, checks, o.T_10, 0.3);
  const Matrix6d other = 0.01 * shifted.diagonal().asDiagonal().toDenseMatrix();
  const Vector6d e = (r.T_10.inverse() * o.T_10).log();
  EXPECT_NEAR(e.dot((shifted + other).ldlt().solve(e)), 2, 0.5) << "one sigma in either direction";
  const std::vector<FeatureCheck> none(checks.size(), FeatureCheck::no_depth);
  EXPECT_TRUE(internal::shift_covariance(kCamera, o.features, none, o.T_10, 0.3).isZero(0));
}

// The same pair as a camera with mirrored rows or columns has it.
TEST(Uncertainty, NegativeFocalLengthsChangeNothing) {
  const Observed o = observe(150, {.depth = 0.005}, 3);
  const PoseResult upright = refine_pose(kCamera, o.features, o.aligned, o.T_10);
  for (const auto& [x, y] : {std::pair(1, -1), {-1, 1}, {-1, -1}}) {
    Camera camera = kCamera;
    camera.fx *= x, camera.fy *= y;
    Observed mirrored = o;
    const auto mirror = [&, center = Eigen::Vector2d(kCamera.cx, kCamera.cy)](Eigen::Vector2d& uv) {
      uv = center + Eigen::Vector2d(x, y).cwiseProduct(uv - center);
    };
    for (Eigen::Vector2d& uv : mirrored.features.uv) mirror(uv);
    for (AlignedFeature& a : mirrored.aligned) {
      mirror(a.uv1);
      a.covariance(0, 1) *= x * y, a.covariance(1, 0) *= x * y;
    }
    const PoseResult r = refine_pose(camera, mirrored.features, mirrored.aligned, o.T_10);
    ASSERT_TRUE(r.converged()) << r.reason;
    EXPECT_LT((r.covariance - upright.covariance).norm(), 1e-4 * upright.covariance.norm()) << x << " " << y;
  }
}

TEST(Uncertainty, StillMovingIsNotCertain) {
  const Observed o = observe(50, {}, 2);
  PoseOptions options;
  options.iterations = 1;
  Vector6d d;
  d << 0.05, 0, 0, 0, 0.01, 0;
  const PoseResult r = refine_pose(kCamera, o.features, o.aligned, o.T_10 * SE3::exp(d), options);
  ASSERT_EQ(r.status, Status::max_iterations) << r.reason;
  EXPECT_GT(r.covariance.diagonal().minCoeff(), 0);
}

// ICLK's own pose, where nothing refines it: what its residuals cannot show is added from the sigma of the depths.
TEST(OwnCovariance, KnowsTheSigmaOfDepths) {
  constexpr double kSigma = 0.04;
  constexpr int kTrials = 24;
  Plan plan{160, 120};
  plan.max_features = 60;
  plan.format = PixelFormat::r32f;
  Cascade cascade({{"classical", [&] { return make_cpu_aligner(plan); }, std::nullopt}});
  double with = 0, without = 0;
  for (uint32_t trial = 0; trial < kTrials; ++trial) {
    test::Relief scene;
    scene.seed = trial + 1;
    scene.T_10 = SE3::exp((Vector6d() << 0.16, -0.12, 0.1, 0.01, -0.012, 0.02).finished());
    Features features = test::random_features(scene, 60, trial);
    std::mt19937 random(trial);
    std::normal_distribution<double> normal(0, 1);
    for (double& q : features.inverse_depth) q *= 1 + kSigma * normal(random);
    const test::Frame image0 = test::render(scene, 0), image1 = test::render(scene, 1);
    const auto nees = [&](const Features& given) {
      const CascadePair pair{{image0.view(), scene.camera, given, {}}, image1.view(), {}};
      const RefinedAlignment r = cascade.align(std::span(&pair, 1)).front();
      EXPECT_TRUE(r.converged()) << r.reason;
      const Vector6d xi = (r.T_10.inverse() * scene.T_10).log();
      return xi.dot(r.covariance.ldlt().solve(xi)) / 6;
    };
    without += nees(features) / kTrials;
    for (const double q : features.inverse_depth) features.inverse_depth_sigma.push_back(kSigma * q);
    with += nees(features) / kTrials;
  }
  EXPECT_GT(without, 4) << "the depths are too good to show anything";
  EXPECT_GT(with, 0.3);
  EXPECT_LT(with, 2);
}

}  // namespace
}  // namespace iclk
