#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <iclk/engine/error.h>
#include <iclk/refine/internal/reprojection.h>
#include <iclk/refine/pose.h>
#include <Eigen/Cholesky>

#include "correspondences.h"

namespace iclk {
namespace {

using test::correspondences;
using test::Scene;
using test::wide_scene;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

Vector6d error_of(const SE3& estimate, const SE3& truth) { return (estimate.inverse() * truth).log(); }

SE3 start_of(const Scene& scene) {
  Vector6d d;
  d << 0.3, -0.3, 0.2, 0.004, -0.004, 0.01;
  return scene.T_10 * SE3::exp(d);
}

TEST(Pose, ReprojectionJacobianAgreesWithFiniteDifferences) {
  for (double fy : {450.0, -450.0}) {
    Scene scene = wide_scene();
    scene.camera.fy = fy;
    const Eigen::Vector3d X0(12, -9, 70);
    const auto J = reprojection_jacobian(scene.camera, scene.T_10, X0);
    for (int k = 0; k < 6; ++k) {
      const double h = 1e-6;
      const auto at = [&](double s) { return scene.camera.project((scene.T_10 * SE3::exp(s * Vector6d::Unit(k))) * X0); };
      const Eigen::Vector2d numeric = (at(h) - at(-h)) / (2 * h);
      EXPECT_LT((J.col(k) - numeric).norm(), 1e-6 * std::max(1.0, numeric.norm())) << "column " << k;
    }
  }
}

TEST(Pose, CostFunctionAgreesWithFiniteDifferencesInOurTwist) {
  const Scene scene = wide_scene();
  Eigen::Matrix2d W;
  W << 0.9, 0.1, 0.1, 0.6;
  const internal::ReprojectionCost cost(scene.camera, scene.camera.ray({200.3, 100.7}), {190, 120}, W);
  const internal::PoseManifold manifold;
  const internal::PoseBlock x = internal::to_block(scene.T_10);
  double q = 0.0131;
  const auto residual = [&](const internal::PoseBlock& pose, double inverse_depth) {
    const double* blocks[] = {pose.data(), &inverse_depth};
    Eigen::Vector2d r;
    EXPECT_TRUE(cost.Evaluate(blocks, r.data(), nullptr));
    return r;
  };
  Eigen::Matrix<double, 2, 12, Eigen::RowMajor> J_pose;
  Eigen::Vector2d J_q, r;
  const double* blocks[] = {x.data(), &q};
  double* jacobians[] = {J_pose.data(), J_q.data()};
  ASSERT_TRUE(cost.Evaluate(blocks, r.data(), jacobians));
  Eigen::Matrix<double, 12, 6, Eigen::RowMajor> plus;
  manifold.PlusJacobian(x.data(), plus.data());
  const double h = 1e-6;
  for (int k = 0; k < 6; ++k) {
    const Vector6d d = h * Vector6d::Unit(k), e = -d;
    internal::PoseBlock a, b;
    manifold.Plus(x.data(), d.data(), a.data());
    manifold.Plus(x.data(), e.data(), b.data());
    EXPECT_LT((plus.col(k) - (a - b) / (2 * h)).norm(), 1e-8) << "PlusJacobian column " << k;
    const Eigen::Vector2d numeric = (residual(a, q) - residual(b, q)) / (2 * h);
    EXPECT_LT((J_pose * plus.col(k) - numeric).norm(), 1e-6 * std::max(1.0, numeric.norm())) << "column " << k;
  }
  const Eigen::Vector2d numeric = (residual(x, q + 1e-8) - residual(x, q - 1e-8)) / 2e-8;
  EXPECT_LT((J_q - numeric).norm(), 1e-4 * numeric.norm());

  Vector6d xi, back;
  xi << 0.4, -0.2, 0.1, 0.05, 0.1, -0.3;
  internal::PoseBlock y;
  manifold.Plus(x.data(), xi.data(), y.data());
  manifold.Minus(y.data(), x.data(), back.data());
  EXPECT_LT((back - xi).norm(), 1e-12);
  Eigen::Matrix<double, 6, 12, Eigen::RowMajor> minus;
  manifold.MinusJacobian(x.data(), minus.data());
  EXPECT_LT((minus * plus - Matrix6d::Identity()).norm(), 1e-12);
}

TEST(Pose, LossDerivativeAgreesWithFiniteDifferences) {
  for (double r : {0.0, 0.05, 0.3, 4.0}) {
    const double c = 0.3, h = 1e-6;
    const auto cost = [&](double x) { return internal::cauchy_cost(std::vector<double>{std::abs(x)}, c); };
    EXPECT_NEAR((cost(r + h) - cost(r - h)) / (2 * h), r / (1 + r * r / (c * c)), 1e-8);  // psi(r) = w r
    // The mean derivative of psi over directions in two dimensions is w^2, which the covariance rests on.
    const auto psi = [&](const Eigen::Vector2d& x) -> Eigen::Vector2d { return x / (1 + x.squaredNorm() / (c * c)); };
    const Eigen::Vector2d x(0.6 * r, 0.8 * r);
    double trace = 0;
    for (int k = 0; k < 2; ++k)
      trace += (psi(x + h * Eigen::Vector2d::Unit(k)) - psi(x - h * Eigen::Vector2d::Unit(k)))[k] / (2 * h);
    EXPECT_NEAR(trace / 2, std::pow(1 / (1 + r * r / (c * c)), 2), 1e-8);
  }
}

TEST(Pose, WhiteningLeavesUnitResidualsOfSharpPatches) {
  Eigen::Matrix2d C;
  C << 0.04, 0.01, 0.01, 0.09;
  const Eigen::Matrix2d W = internal::whitening(C, 0.1);
  EXPECT_LT((W * (C + 0.01 * Eigen::Matrix2d::Identity()) * W.transpose() - 0.01 * Eigen::Matrix2d::Identity()).norm(), 1e-14);
  EXPECT_LT((internal::whitening(Eigen::Matrix2d::Zero(), 0.1) - Eigen::Matrix2d::Identity()).norm(), 1e-14);
}

TEST(Pose, IsExactOnExactCorrespondencesWithGrossOutliers) {
  const Scene scene = wide_scene();
  for (uint32_t seed = 0; seed < 20; ++seed) {
    std::mt19937 random(seed);
    const Features f = test::random_features(scene, 50, seed);
    std::vector<AlignedFeature> a = correspondences(scene, f, 0, random);
    for (int i = 0; i < 15; ++i) a[i].uv1 += Eigen::Vector2d(5 + i, i % 2 ? -8 : 8);
    const PoseResult r = refine_pose(scene.camera, f, a, start_of(scene));
    ASSERT_EQ(r.status, Status::converged) << r.reason;
    EXPECT_EQ(r.used, 50);
    EXPECT_EQ(r.inliers, 35);
    // The outliers that one side has more of pull a little: they weigh 0.3^2 / |r|^2, no more.
    EXPECT_LT((scene.camera.project(r.T_10 * Eigen::Vector3d(0, 0, 80)) -
               scene.camera.project(scene.T_10 * Eigen::Vector3d(0, 0, 80)))
                  .norm(),
              0.02);
    EXPECT_LT(r.cost, r.initial_cost);
  }
  std::mt19937 random(1);
  const Features f = test::random_features(scene, 12, 1);
  const PoseResult r = refine_pose(scene.camera, f, correspondences(scene, f, 0, random), start_of(scene));
  ASSERT_TRUE(r.converged()) << r.reason;
  EXPECT_LT(error_of(r.T_10, scene.T_10).norm(), 1e-6);
}

TEST(Pose, AFarStartWithOutliersComesHome) {
  const Scene scene = wide_scene();
  int home = 0;
  for (uint32_t seed = 0; seed < 30; ++seed) {
    std::mt19937 random(seed);
    const Features f = test::random_features(scene, 40, seed);
    Vector6d d;
    d << 1, -1, 2, 0.02, -0.03, 0.05;  // about 25 px
    const PoseResult r = refine_pose(scene.camera, f, correspondences(scene, f, 0.05, random, 0.3), scene.T_10 * SE3::exp(d));
    home += r.converged() && error_of(r.T_10, scene.T_10).norm() < 0.2;
  }
  EXPECT_GE(home, 29);
}

TEST(Pose, CovarianceIsThatOfTheErrors) {
  const Scene scene = wide_scene();
  struct Case {
    int n;
    double sigma, outliers, low, high;
  };
  // Cautious by what it allows for and is not there: a camera that is a little wrong. The last: residuals wider than the loss.
  for (const Case& c :
       {Case{50, 0.1, 0, 0.65, 1.2}, Case{50, 0.05, 0.2, 0.45, 1.2}, Case{12, 0.1, 0, 0.5, 1.3}, Case{50, 1.0, 0, 0.4, 1.2}}) {
    std::mt19937 random(3);
    double nees = 0;
    int converged = 0;
    for (int run = 0; run < 200; ++run) {
      const Features f = test::random_features(scene, c.n, 100 + run);
      const PoseResult r =
          refine_pose(scene.camera, f, correspondences(scene, f, c.sigma, random, c.outliers), start_of(scene));
      if (!r.converged()) continue;
      const Vector6d e = error_of(r.T_10, scene.T_10);
      nees += e.dot(r.covariance.ldlt().solve(e)) / 6;
      ++converged;
    }
    nees /= converged;
    RecordProperty("nees_" + std::to_string(c.n) + "_" + std::to_string(c.sigma), std::to_string(nees));
    EXPECT_GT(converged, 150);
    EXPECT_GT(nees, c.low) << c.n << " features, sigma " << c.sigma << ", outliers " << c.outliers;
    EXPECT_LT(nees, c.high) << c.n << " features, sigma " << c.sigma << ", outliers " << c.outliers;
  }
}

// Positions whose noise the patches do not know of, as a room's depth makes it, beside sharp and vague ones.
TEST(Pose, TheFloorIsWhatTheResidualsSay) {
  const Scene scene = wide_scene();
  for (const double noise : {0.005, 0.1, 0.4}) {
    SCOPED_TRACE(testing::Message() << noise << " px");
    PoseOptions fixed;
    fixed.min_sigma = fixed.max_sigma = fixed.sigma;
    double error = 0, fixed_error = 0;
    for (uint32_t seed = 0; seed < 40; ++seed) {
      std::mt19937 random(seed);
      std::normal_distribution<double> normal(0, 1);
      const Features f = test::random_features(scene, 80, seed);
      std::vector<AlignedFeature> a = correspondences(scene, f, noise, random, 0.1);
      for (size_t i = 0; i < a.size(); ++i) {
        const double own = i % 2 ? 0.02 : 0.3;
        a[i].covariance = own * own * Eigen::Matrix2d::Identity();
        a[i].uv1 += own * Eigen::Vector2d(normal(random), normal(random));
      }
      const PoseResult r = refine_pose(scene.camera, f, a, start_of(scene), {}),
                       other = refine_pose(scene.camera, f, a, start_of(scene), fixed);
      ASSERT_TRUE(r.converged()) << r.reason;
      EXPECT_GE(r.floor, PoseOptions().min_sigma);
      EXPECT_LT(r.floor, std::max(1.6 * noise, 0.12));
      EXPECT_GT(r.floor, 0.6 * noise);
      EXPECT_EQ(other.floor, fixed.sigma);
      error += error_of(r.T_10, scene.T_10).squaredNorm();
      fixed_error += error_of(other.T_10, scene.T_10).squaredNorm();
    }
    EXPECT_LT(error, (noise == 0.1 ? 1.05 : 0.9) * fixed_error);
  }
}

TEST(Pose, AVagueFeatureCountsLess) {
  const Scene scene = wide_scene();
  std::mt19937 random(1);
  const Features f = test::random_features(scene, 20, 1);
  std::vector<AlignedFeature> a = correspondences(scene, f, 0, random);
  for (int i = 0; i < 10; ++i) a[i].uv1.x() += 0.2;
  const double trusted = error_of(refine_pose(scene.camera, f, a, scene.T_10).T_10, scene.T_10).norm();
  for (int i = 0; i < 10; ++i) a[i].covariance = Eigen::Vector2d(1, 1e-4).asDiagonal();  // and they say so
  const double doubted = error_of(refine_pose(scene.camera, f, a, scene.T_10).T_10, scene.T_10).norm();
  EXPECT_LT(doubted, 0.2 * trusted);
}

TEST(Pose, SaysWhyItDidNotConverge) {
  const Scene scene = wide_scene();
  std::mt19937 random(1);
  const Features f = test::random_features(scene, 30, 1);
  std::vector<AlignedFeature> a = correspondences(scene, f, 0.05, random);

  std::vector<AlignedFeature> few = a;
  for (size_t i = 5; i < few.size(); ++i) few[i].status = FeatureStatus::bad_match;
  const PoseResult too_few = refine_pose(scene.camera, f, few, scene.T_10);
  EXPECT_EQ(too_few.status, Status::too_few_features);
  EXPECT_NE(too_few.reason.find("5 aligned features, 6 needed"), std::string::npos) << too_few.reason;
  EXPECT_EQ(too_few.covariance, Matrix6d::Zero());

  std::vector<AlignedFeature> chaos = a;
  std::uniform_real_distribution<double> far(-60, 60);
  for (AlignedFeature& x : chaos) x.uv1 += Eigen::Vector2d(far(random), far(random));
  const PoseResult diverged = refine_pose(scene.camera, f, chaos, scene.T_10);
  EXPECT_EQ(diverged.status, Status::diverged);
  EXPECT_NE(diverged.reason.find("of 30 features within 1.5 px"), std::string::npos) << diverged.reason;

  Features point = f;  // all on one ray and one depth: three directions remain free
  for (int i = 0; i < point.size(); ++i) {
    point.uv[i] = {200, 150};
    point.inverse_depth[i] = 1 / scene.depth({200, 150});
  }
  const PoseResult degenerate = refine_pose(scene.camera, point, correspondences(scene, point, 0, random), scene.T_10);
  EXPECT_EQ(degenerate.status, Status::degenerate) << degenerate.reason;
  EXPECT_EQ(degenerate.covariance, Matrix6d::Zero());

  Features line = f;  // the camera may turn about them
  for (int i = 0; i < line.size(); ++i) {
    line.uv[i] = {100.0 + 14 * i, 239.5 + (i % 2) * 1e-3};  // nearly: the system is not singular, only useless
    line.inverse_depth[i] = 0.0125;
  }
  std::vector<AlignedFeature> on_line(30);
  for (int i = 0; i < 30; ++i) {
    on_line[i].status = FeatureStatus::aligned;
    on_line[i].uv1 = scene.camera.project(scene.T_10 * (scene.camera.ray(line.uv[i]) / line.inverse_depth[i]));
  }
  const PoseResult turning = refine_pose(scene.camera, line, on_line, scene.T_10);
  EXPECT_EQ(turning.status, Status::degenerate) << turning.reason;

  PoseOptions hasty;
  hasty.iterations = 1;
  hasty.cauchy_scale = 100;
  EXPECT_EQ(refine_pose(scene.camera, f, a, start_of(scene), hasty).status, Status::max_iterations);
}

TEST(Pose, TheUnitOfLengthDoesNotMatter) {
  Scene scene = wide_scene();
  std::mt19937 random(1);
  Features f = test::random_features(scene, 30, 1);
  const std::vector<AlignedFeature> a = correspondences(scene, f, 0.05, random);
  const PoseResult metres = refine_pose(scene.camera, f, a, start_of(scene));
  ASSERT_TRUE(metres.converged()) << metres.reason;
  for (double unit : {1e-7, 1e7}) {
    Features scaled = f;
    for (double& q : scaled.inverse_depth) q /= unit;
    SE3 start = start_of(scene);
    start.t *= unit;
    const PoseResult r = refine_pose(scene.camera, scaled, a, start);
    ASSERT_TRUE(r.converged()) << r.reason;
    EXPECT_LT((r.T_10.t / unit - metres.T_10.t).norm(), 1e-6);
    EXPECT_LT((r.T_10.R - metres.T_10.R).norm(), 1e-8);
    EXPECT_NEAR(r.covariance(0, 0) / (unit * unit) / metres.covariance(0, 0), 1, 1e-4);
    EXPECT_NEAR(r.covariance(0, 5) / unit / metres.covariance(0, 5), 1, 1e-3);
    EXPECT_NEAR(r.covariance(5, 5) / metres.covariance(5, 5), 1, 1e-4);
  }
}

TEST(Pose, HostileInput) {
  const Scene scene = wide_scene();
  std::mt19937 random(1);
  Features f = test::random_features(scene, 30, 1);
  std::vector<AlignedFeature> a = correspondences(scene, f, 0, random);
  a[0].uv1.x() = kNaN;
  a[1].covariance(0, 0) = kNaN;
  f.uv[2].x() = kNaN;
  f.inverse_depth[3] = -1;
  f.inverse_depth[4] = kNaN;
  f.inverse_depth[5] = 0;
  const PoseResult r = refine_pose(scene.camera, f, a, start_of(scene));
  ASSERT_TRUE(r.converged()) << r.reason;
  EXPECT_EQ(r.used, 24);
  EXPECT_LT(error_of(r.T_10, scene.T_10).norm(), 1e-6);

  SE3 nan = scene.T_10;
  nan.t.x() = kNaN;
  EXPECT_THROW(refine_pose(scene.camera, f, a, nan), Error);
  EXPECT_THROW(refine_pose(scene.camera, f, std::span(a).first(3), scene.T_10), Error);
  Camera broken = scene.camera;
  broken.fx = 0;
  EXPECT_THROW(refine_pose(broken, f, a, scene.T_10), Error);
  SE3 behind;
  behind.t.z() = -1000;
  EXPECT_EQ(refine_pose(scene.camera, f, a, behind).status, Status::too_few_features);
  PoseOptions options;
  options.cauchy_scale = 0;
  EXPECT_THROW(refine_pose(scene.camera, f, a, scene.T_10, options), Error);
  EXPECT_EQ(refine_pose(scene.camera, {}, {}, scene.T_10).status, Status::too_few_features);
}

}  // namespace
}  // namespace iclk
