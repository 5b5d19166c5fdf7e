// What errors of a map do to a pose.
#include <random>

#include <gtest/gtest.h>
#include <iclk/locate/internal/map_errors.h>
#include <Eigen/LU>

#include "../apps/render_fixture.h"

namespace iclk {
namespace {

using Eigen::Vector3d;

const Camera kCamera{300, 300, 159.5, 119.5, 320, 240};

/// Ground 60 m below, seen in a grid of n x n places.
std::vector<Vector3d> ground(int n, double spread = 1) {
  std::vector<Vector3d> points;
  for (int i = 0; i < n * n; ++i) {
    const Eigen::Vector2d uv(160 + spread * (i % n - 0.5 * n) * 300 / n, 120 + spread * (i / n - 0.5 * n) * 220 / n);
    points.push_back(60 * kCamera.ray(uv) + Vector3d(0, 0, 3 * std::sin(5.0 * i)));
  }
  return points;
}

Matrix6d covariance(const std::vector<Vector3d>& points, const internal::MapErrors& errors) {
  return internal::map_covariance(kCamera, points, test::looking_down({0, 0, 60}, 0.7, 0.1).R, errors);
}

TEST(MapErrors, FeaturesThatErrTogetherAreNoMoreInformation) {
  const double few = covariance(ground(6), {0.5, 0, 0})(0, 0), many = covariance(ground(20), {0.5, 0, 0})(0, 0);
  EXPECT_NEAR(many / few, 1, 0.25);
  EXPECT_NEAR(covariance(ground(6), {1, 0, 0})(0, 0) / few, 4, 1e-6);
}

TEST(MapErrors, AShiftOfTheGroundMovesTheCamera) {
  const Eigen::Matrix3d R = test::looking_down({0, 0, 60}, 0.7, 0.1).R;
  const Matrix6d map = covariance(ground(20), {1e-3, 2, 0});
  const Eigen::Matrix3d position = R * map.topLeftCorner<3, 3>() * R.transpose();
  EXPECT_NEAR(std::sqrt(position(0, 0)), 0.6, 0.01);
  EXPECT_NEAR(std::sqrt(position(1, 1)), 0.6, 0.01);
  EXPECT_LT(std::sqrt(position(2, 2)), 0.05);
  EXPECT_GT(covariance(ground(20), {0.3, 0, 4}).trace(), covariance(ground(20), {0.3, 0, 0}).trace());
}

TEST(MapErrors, PointsThatLeaveThePoseOpenHaveNone) {
  EXPECT_TRUE(covariance({}, {1, 1, 1}).isZero());
  EXPECT_TRUE(covariance({{0, 0, 60}, {0, 0, 60}, {0, 0, 60}, {0, 0, 60}}, {1, 0, 0}).isZero());
}

}  // namespace
}  // namespace iclk
