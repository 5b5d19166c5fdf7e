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

TEST(MapErrors, AnotherSunMovesRoughGround) {
  const Eigen::Matrix3d R = test::looking_down({0, 0, 60}, 0.7, 0.1).R;
  const std::vector<Vector3d> points = ground(20);
  std::vector<double> rough(points.size(), 2);
  const auto map = [&] { return covariance(points, {1e-3, 0, 0, rough}); };
  const Eigen::Matrix3d position = R * map().topLeftCorner<3, 3>() * R.transpose();
  EXPECT_NEAR(std::sqrt(position(0, 0)), 1.2, 0.1);
  EXPECT_NEAR(std::sqrt(position(1, 1)), 1.2, 0.1);
  EXPECT_NEAR(internal::ground_sigma(kCamera, points, map()), 1.2, 0.1);
  const auto turn = [&] { return std::sqrt(map().bottomRightCorner<3, 3>().trace()); };
  EXPECT_LT(turn(), 0.01);
  for (size_t i = 0; i < points.size(); ++i) rough[i] = points[i].x() < 0 ? 2 : 0;
  EXPECT_GT(turn(), 0.015) << "woods on one side: the camera seems tilted";
}

TEST(MapErrors, CrownsAreRoughAndSlopesAreNot) {
  Terrain map;
  map.relief = {41, 41, 0, 41, 1, 1};
  for (int v = 0; v < 41; ++v)
    for (int u = 0; u < 41; ++u) {
      const bool crown = u > 20 && (u / 3 + v / 3) % 2 == 0;
      map.height.push_back(static_cast<float>(0.5 * u + 0.2 * v + (crown ? 6 : 0)));
    }
  EXPECT_LT(internal::ground_roughness(map, 9.5, 20.5), 1e-4);
  const double rough = internal::ground_roughness(map, 30.5, 20.5);
  EXPECT_NEAR(rough, 3, 1);
  EXPECT_GT(internal::ground_roughness(map, 39.5, 20.5), 1) << "near the border";
  map.height[20 * 41 + 28] = NAN;
  EXPECT_NEAR(internal::ground_roughness(map, 30.5, 20.5), rough, 0.5) << "a height is missing";
}

TEST(MapErrors, PointsThatLeaveThePoseOpenHaveNone) {
  EXPECT_TRUE(covariance({}, {1, 1, 1}).isZero());
  EXPECT_TRUE(covariance({{0, 0, 60}, {0, 0, 60}, {0, 0, 60}, {0, 0, 60}}, {1, 0, 0}).isZero());
}

}  // namespace
}  // namespace iclk
