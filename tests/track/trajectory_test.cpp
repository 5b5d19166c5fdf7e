#include <cmath>

#include <gtest/gtest.h>

#include <iclk/track/trajectory.h>

namespace iclk {
namespace {

std::vector<PosePair> way() {
  std::vector<PosePair> pairs;
  Vector6d world;
  world << 3, -2, 1, 0.4, -1.1, 2.0;
  for (int i = 0; i < 50; ++i) {
    const double a = 0.1 * i;
    Vector6d xi;
    xi << std::cos(a), std::sin(2 * a), 0.3 * a, 0.2 * std::sin(a), 0.1 * a, 0.05;
    const SE3 T = SE3::exp(xi);
    pairs.push_back({SE3::exp(world) * T, T});
  }
  return pairs;
}

TEST(Trajectory, AnotherWorldIsNoError) {
  const auto pairs = way();
  const TrajectoryError error = absolute_error(pairs);
  EXPECT_LT(error.max, 1e-12);
  EXPECT_LT((error.alignment * pairs[7].estimate.t - pairs[7].truth.t).norm(), 1e-12);
  const RelativeError relative = relative_error(pairs, 10);
  EXPECT_EQ(relative.count, 40);
  EXPECT_LT(relative.translation, 1e-12);
  EXPECT_LT(relative.rotation, 1e-7);
}

TEST(Trajectory, ErrorsAreWhatWasPutIn) {
  auto pairs = way();
  // Two positions pulled apart along a line through the middle of all: the alignment keeps nearly where it was.
  pairs[10].estimate.t += Eigen::Vector3d(0.01, 0, 0);
  const TrajectoryError error = absolute_error(pairs);
  EXPECT_NEAR(error.rmse, 0.01 / std::sqrt(50.0), 2e-4);
  EXPECT_NEAR(error.max, 0.01, 1e-3);
  EXPECT_LT(error.median, 1e-3);
  // One pose that is off by 0.01 rad is in two motions of 40.
  auto turned = way();
  turned[25].estimate = turned[25].estimate * SE3::exp((Vector6d() << 0, 0, 0, 0, 0.01, 0).finished());
  EXPECT_NEAR(relative_error(turned, 10).rotation, 0.01 * std::sqrt(2 / 40.0), 1e-6);
  EXPECT_NEAR(way_length({pairs.data(), 2}), (pairs[1].truth.t - pairs[0].truth.t).norm(), 1e-12);
}

TEST(Trajectory, LittleIsNothing) {
  EXPECT_EQ(absolute_error({}).rmse, 0);
  EXPECT_EQ(relative_error({}, 30).count, 0);
  EXPECT_EQ(way_length({}), 0);
}

}  // namespace
}  // namespace iclk
