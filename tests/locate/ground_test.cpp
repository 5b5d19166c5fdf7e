// Pixels to ground: against a plane whose intersection is known, and against what poses drawn from the covariance see.
#include <cmath>
#include <random>

#include <gtest/gtest.h>
#include <iclk/locate/ground.h>
#include <Eigen/Cholesky>

#include "../apps/render_fixture.h"

namespace iclk {
namespace {

const Camera kCamera{300, 310, 161, 118, 320, 240};

/// The ground N X = 1, seen from a pose.
struct Plane {
  Eigen::Vector3d N;

  Eigen::Vector3d meet(const SE3& T_WC, const Eigen::Vector2d& pixel) const {
    const Eigen::Vector3d d = T_WC.R * kCamera.ray(pixel);
    return T_WC.t + (1 - N.dot(T_WC.t)) / N.dot(d) * d;
  }
  View view(const SE3& T_WC) const {
    View view{kCamera.width, kCamera.height, {}, {}};
    for (int v = 0; v < view.height; ++v)
      for (int u = 0; u < view.width; ++u) view.depth.push_back(static_cast<float>((T_WC.inverse() * meet(T_WC, {u, v})).z()));
    return view;
  }
};

/// z = 10 + 0.2 x - 0.1 y
const Plane kSlope{Eigen::Vector3d(-0.2, 0.1, 1) / 10};

Located located() {
  Located l;
  l.status = Status::converged;
  l.T_WC = test::looking_down({3, 4, 90}, 0.7, 0.4, 0.2);
  Vector6d sigma;
  sigma << 0.3, 0.2, 0.4, 2e-3, 3e-3, 1e-3;
  l.covariance = sigma.cwiseAbs2().asDiagonal();
  l.covariance(0, 4) = l.covariance(4, 0) = 0.7 * 0.3 * 3e-3;
  return l;
}

TEST(Ground, OfAPlaneIsExact) {
  const Located l = located();
  const View view = kSlope.view(l.T_WC);
  for (const Eigen::Vector2d& pixel : {Eigen::Vector2d(160, 120), {0, 0}, {319, 239}, {10.4, 200.7}, {318.6, 0.5}}) {
    const auto point = ground_point(view, kCamera, l, pixel, 0);
    ASSERT_TRUE(point) << pixel.transpose();
    EXPECT_LT((point->X - kSlope.meet(l.T_WC, pixel)).norm(), 1e-3) << pixel.transpose();
  }
  EXPECT_FALSE(ground_point(view, kCamera, l, {-0.6, 5}, 0));
  EXPECT_FALSE(ground_point(view, kCamera, l, {NAN, 5}, 0));
  Located lost = l;
  lost.status = Status::ambiguous;
  EXPECT_FALSE(ground_point(view, kCamera, lost, {160, 120}, 0));
  View hole = view;
  hole.depth[120 * 320 + 160] = 0;
  EXPECT_FALSE(ground_point(hole, kCamera, l, {160.3, 120}, 0));
  EXPECT_TRUE(ground_point(hole, kCamera, l, {161, 120}, 0)) << "beside the hole";
}

TEST(Ground, EndsAtAnEdge) {
  const Located l = located();
  View view = kSlope.view(l.T_WC);
  const Plane roof{kSlope.N * 10 / 30};  // 20 m higher
  const View high = roof.view(l.T_WC);
  for (int v = 0; v < 240; ++v)
    std::copy_n(&high.depth[static_cast<size_t>(v) * 320], 160, &view.depth[static_cast<size_t>(v) * 320]);
  EXPECT_LT((ground_point(view, kCamera, l, {159.3, 80}, 0)->X - roof.meet(l.T_WC, {159.3, 80})).norm(), 1e-3);
  EXPECT_LT((ground_point(view, kCamera, l, {159.8, 80}, 0)->X - kSlope.meet(l.T_WC, {159.8, 80})).norm(), 1e-3);
}

TEST(Ground, CovarianceIsThatOfManyPoses) {
  const Located l = located();
  const View view = kSlope.view(l.T_WC);
  const Eigen::Matrix<double, 6, 6> L = l.covariance.llt().matrixL();
  std::mt19937 random(4);
  std::normal_distribution<double> normal;
  constexpr double kElevation = 0.8;
  constexpr int kPoses = 20000;
  for (const Eigen::Vector2d& pixel : {Eigen::Vector2d(150, 130), {20, 15}}) {
    const auto point = ground_point(view, kCamera, l, pixel, kElevation);
    ASSERT_TRUE(point);
    Eigen::Matrix3d seen = Eigen::Matrix3d::Zero();
    for (int i = 0; i < kPoses; ++i) {
      Vector6d xi;
      for (int k = 0; k < 6; ++k) xi[k] = normal(random);
      const Plane lifted{kSlope.N / (1 + kSlope.N.z() * kElevation * normal(random))};
      const Eigen::Vector3d e = lifted.meet(l.T_WC * SE3::exp(L * xi), pixel) - point->X;
      seen += e * e.transpose() / kPoses;
    }
    EXPECT_LT((seen - point->covariance).norm(), 0.04 * seen.norm()) << seen << "\n\n" << point->covariance;
    EXPECT_GT((ground_point(view, kCamera, l, pixel, 0)->covariance - seen).norm(), 0.04 * seen.norm());
  }
}

TEST(Ground, EllipseOfACovariance) {
  const double azimuth = 110 * M_PI / 180;
  const Eigen::Vector2d along(std::sin(azimuth), std::cos(azimuth)), across(-along.y(), along.x());
  Eigen::Matrix3d C = Eigen::Matrix3d::Identity();
  C.topLeftCorner<2, 2>() = 9 * along * along.transpose() + 4 * across * across.transpose();
  const ErrorEllipse ellipse = error_ellipse(C);
  EXPECT_NEAR(ellipse.major, 3, 1e-9);
  EXPECT_NEAR(ellipse.minor, 2, 1e-9);
  EXPECT_NEAR(ellipse.azimuth, azimuth, 1e-9);
}

}  // namespace
}  // namespace iclk
