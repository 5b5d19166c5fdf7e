// A camera's way between given poses.
#include <cmath>

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "apps/iclk/sets/flight_path.h"
#include "files.h"

namespace iclk {
namespace {

using test::expect_error;

SE3 even(double t) {
  Vector6d turn = Vector6d::Zero();
  turn.tail<3>() = t * Eigen::Vector3d(0.2, -0.1, 0.3);
  return {SE3::exp(turn).R, Eigen::Vector3d(3 + 2 * t, -1 - t, 100 + 0.5 * t)};
}

SE3 curved(double t) {
  Vector6d turn = Vector6d::Zero();
  turn.tail<3>() = Eigen::Vector3d(0.3 * std::sin(t), 0.2 * std::cos(0.7 * t), 0.4 * t);
  return {SE3::exp(turn).R, Eigen::Vector3d(10 * std::sin(t), 5 * t, 50 + 3 * std::cos(t))};
}

template <typename F>
FlightPath path_of(const F& pose, std::initializer_list<double> times) {
  std::vector<StampedPose> poses;
  for (const double t : times) poses.push_back({t, pose(t)});
  return {poses, "flight.txt"};
}

double apart(const SE3& a, const SE3& b) { return (a.matrix() - b.matrix()).norm(); }

TEST(FlightPath, GoesThroughItsPosesAndIsAnEvenMotionWhereTheyAre) {
  const FlightPath path = path_of(even, {1, 2, 2.5, 4, 7});
  for (double t = 1; t <= 7; t += 0.13) EXPECT_LT(apart(path.at(t), even(t)), 1e-9) << t;
  const FlightPath way = path_of(curved, {0, 0.5, 0.8, 1.5, 2});
  for (const double t : {0.0, 0.5, 0.8, 1.5, 2.0}) EXPECT_EQ(apart(way.at(t), curved(t)), 0) << "exactly the pose";
  EXPECT_EQ(apart(way.at(-1), curved(0)), 0);
  EXPECT_EQ(apart(way.at(9), curved(2)), 0);
  EXPECT_EQ(apart(path_of(even, {3}).at(5), even(3)), 0);
  EXPECT_LT(apart(path_of(even, {1, 3}).at(1.7), even(1.7)), 1e-9);
}

TEST(FlightPath, IsSmoothAndNearACurve) {
  const FlightPath path = path_of(curved, {0, 0.4, 0.8, 1.2, 1.6, 2.0});
  for (double t = 0.4; t <= 1.6; t += 0.07) EXPECT_LT(apart(path.at(t), curved(t)), 0.05) << t;
  // Velocities before and behind a pose: straight pieces would jump by metres a second.
  const double h = 1e-4;
  for (const double t : {0.4, 0.8, 1.2, 1.6}) {
    const Vector6d before = (path.at(t - h).inverse() * path.at(t)).log() / h,
                   behind = (path.at(t).inverse() * path.at(t + h)).log() / h;
    EXPECT_LT((before - behind).norm(), 0.02) << t;
  }
}

TEST(FlightPath, TimesOfFrames) {
  const FlightPath path = path_of(even, {1, 2, 2.5, 4});
  EXPECT_EQ(path.times(0, 0), (std::vector<double>{1, 2, 2.5, 4}));
  EXPECT_EQ(path.times(0, 0.1), (std::vector<double>{2, 2.5})) << "first and last readouts are not all within";
  EXPECT_EQ(path.times(2, 0), (std::vector<double>{1, 1.5, 2, 2.5, 3, 3.5, 4}));
  EXPECT_EQ(path.times(10, 0).size(), 31u);
  EXPECT_LE(path.times(30, 0).back(), 4);
  EXPECT_TRUE(path.times(0, 9).empty());
  EXPECT_EQ(path_of(even, {5}).times(30, 0).size(), 1u);
  expect_error([&] { path.times(1e8, 0); }, ErrorCode::invalid_argument, {"300000000 frames", "rate"});
}

TEST(FlightPath, WhatIsNoPathIsNamed) {
  const auto refused = [](std::vector<StampedPose> poses, std::initializer_list<const char*> pieces) {
    expect_error([&] { FlightPath(poses, "flight.txt"); }, ErrorCode::invalid_argument, pieces);
  };
  refused({}, {"flight.txt", "no pose"});
  refused({{1, {}}, {1, {}}}, {"two poses at 1 s"});
  refused({{-1, {}}, {1, {}}}, {"from -1"});
  refused({{1, {}}, {1e10, {}}}, {"to 10000000000"});
}

}  // namespace
}  // namespace iclk
