#include <cmath>
#include <random>

#include <Eigen/Geometry>

#include <iclk/session/io/feature_csv.h>
#include <iclk/session/io/pose_text.h>
#include <iclk/session/io/text.h>

#include "files.h"

namespace iclk {
namespace {

using test::expect_error;
using test::Folder;

TEST(FeatureCsv, DepthAndInverseDepth) {
  const Folder folder;
  const Features a = load_features(folder.write("a.csv", "u,v,depth\n10.5, 20 ,2\r\n# a comment\n\n30,40,0.5\n"));
  ASSERT_EQ(a.size(), 2);
  EXPECT_EQ(a.uv[0], Eigen::Vector2d(10.5, 20));
  EXPECT_EQ(a.inverse_depth[0], 0.5);
  EXPECT_EQ(a.inverse_depth[1], 2);
  EXPECT_TRUE(a.inverse_depth_sigma.empty());
  const Features b = load_features(folder.write("b.csv", "\xef\xbb\xbfid,inverse_depth,v,u\n7,0.25,2,1"));
  EXPECT_EQ(b.uv[0], Eigen::Vector2d(1, 2));
  EXPECT_EQ(b.inverse_depth[0], 0.25);
}

TEST(FeatureCsv, SigmaIsOfTheDepthColumn) {
  const Folder folder;
  const Features a = load_features(folder.write("a.csv", "u,v,depth,sigma\n1,2,4,0.1\n"));
  EXPECT_DOUBLE_EQ(a.inverse_depth_sigma[0], 0.1 / 16);  // dq = dz / z^2
  const Features b = load_features(folder.write("b.csv", "u,v,inverse_depth,sigma\n1,2,4,0.1\n"));
  EXPECT_DOUBLE_EQ(b.inverse_depth_sigma[0], 0.1);
}

TEST(FeatureCsv, OddValuesAreKeptForTheVerdict) {
  const Folder folder;
  const Features a = load_features(folder.write("a.csv", "u,v,depth\n1,2,nan\n1,2,inf\n1,2,0\n1,2,-3\nnan,2,1\n"));
  ASSERT_EQ(a.size(), 5);
  const std::vector<FeatureCheck> checks = check_features(a, {100, 100, 50, 50, 100, 100});
  EXPECT_EQ(checks[0], FeatureCheck::not_finite);
  EXPECT_EQ(checks[1], FeatureCheck::no_depth);
  EXPECT_EQ(checks[2], FeatureCheck::no_depth);
  EXPECT_EQ(checks[3], FeatureCheck::no_depth);
  EXPECT_EQ(checks[4], FeatureCheck::not_finite);
}

TEST(FeatureCsv, ErrorsNameTheLine) {
  const Folder folder;
  const auto load = [&](const std::string& text) { return [&, text] { load_features(folder.write("f.csv", text)); }; };
  expect_error(load("1,2,3\n4,5,6\n"), ErrorCode::invalid_argument, {"f.csv:1", "header"});
  expect_error(load("u,v\n1,2\n"), ErrorCode::invalid_argument, {"f.csv:1", "header"});
  expect_error(load("u,v,depth,inverse_depth\n1,2,3,4\n"), ErrorCode::invalid_argument, {"f.csv:1", "header"});
  expect_error(load("u,v,depth\n1,2,3\n1,2\n4,5,6\n"), ErrorCode::invalid_argument, {"f.csv:3", "2 cells"});
  expect_error(load("u,v,depth\n1,2,3\n1,2,x\n4,5,6\n"), ErrorCode::invalid_argument, {"f.csv:3", "'x'"});
  expect_error(load("u,v,depth\n1,2,3\n1,2,3 4\n"), ErrorCode::invalid_argument, {"f.csv:3", "'3 4'"});
  expect_error(load("u,v,depth\n1,,3\n"), ErrorCode::invalid_argument, {"f.csv:2", "''"});
  expect_error(load("u,v,depth,sigma\n1,2,3,-1\n"), ErrorCode::invalid_argument, {"f.csv:2", "sigma"});
  expect_error(load(""), ErrorCode::invalid_argument, {"f.csv:1", "empty"});
  expect_error(load(std::string("\x89PNG\r\n\x1a\n\0\0", 10)), ErrorCode::invalid_argument, {"f.csv:1"});
  expect_error([&] { load_features(folder.path("none.csv")); }, ErrorCode::io, {"none.csv"});
  EXPECT_EQ(load_features(folder.write("f.csv", "u,v,depth\n")).size(), 0);
}

SE3 some_pose() {
  Vector6d xi;
  xi << 0.1, -0.2, 0.3, 0.4, -0.5, 0.6;
  return SE3::exp(xi);
}

double distance(const SE3& a, const SE3& b) { return (a.matrix() - b.matrix()).cwiseAbs().maxCoeff(); }

TEST(PoseText, TumLine) {
  // A quarter turn about z maps x onto y.
  const SE3 T = load_pose("1 2 3 0 0 0.70710678118 0.70710678118", "--truth");
  EXPECT_NEAR((T * Eigen::Vector3d(1, 0, 0) - Eigen::Vector3d(1, 3, 3)).norm(), 0, 1e-9);
  EXPECT_LT(distance(load_pose("1305031790.64, 1,2,3,0,0,0.70710678118,0.70710678118", "x"), T), 1e-12);
  EXPECT_LT(distance(load_pose(tum_line(some_pose()), "x"), some_pose()), 1e-9);
}

TEST(PoseText, Matrix) {
  const Eigen::Matrix4d M = some_pose().matrix();
  std::string text = "[";
  for (int r = 0; r < 4; ++r) {
    text += "[";
    for (int c = 0; c < 4; ++c) text += std::to_string(M(r, c)) + (c < 3 ? ", " : "");
    text += "],\n";
  }
  text += "]";
  EXPECT_LT(distance(load_pose(text, "x"), some_pose()), 1e-5);
  const Folder folder;
  EXPECT_LT(distance(load_pose(folder.write("pose.txt", "# T_10\n" + text), "x"), some_pose()), 1e-5);
}

TEST(PoseText, Errors) {
  const Folder folder;
  const auto load = [](const std::string& text) { return [text] { load_pose(text, "--truth"); }; };
  expect_error(load("1 2 3 0 0 0 2"), ErrorCode::invalid_argument, {"--truth", "norm"});
  expect_error(load("1 2 3 0 0 0 0"), ErrorCode::invalid_argument, {"--truth", "norm"});
  expect_error(load("2 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"), ErrorCode::invalid_argument, {"--truth", "rotation"});
  expect_error(load("-1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"), ErrorCode::invalid_argument, {"--truth"});  // a mirror
  expect_error(load("1 2 3"), ErrorCode::invalid_argument, {"--truth", "3 numbers"});
  expect_error([&] { load_pose(folder.write("p.txt", "1 2 three 0 0 0 1"), "--truth"); }, ErrorCode::invalid_argument,
               {"p.txt", "'three'"});
  expect_error([&] { load_pose(folder.write("p.txt", "1 2 nan 0 0 0 1"), "--truth"); }, ErrorCode::invalid_argument,
               {"p.txt", "finite"});
  expect_error([&] { load_pose(folder.path("none.txt"), "--truth"); }, ErrorCode::io, {"none.txt"});
}

TEST(PoseText, Interpolation) {
  const SE3 a, b{Eigen::AngleAxisd(1.0, Eigen::Vector3d::UnitZ()).toRotationMatrix(), {2, 0, 0}};
  const std::vector<StampedPose> line = {{10, a}, {11, b}, {20, b}};
  SE3 T;
  ASSERT_TRUE(interpolate(line, 10.25, 2, T));
  EXPECT_NEAR(T.angle(), 0.25, 1e-12);
  EXPECT_NEAR(T.t.x(), 0.5, 1e-12);
  ASSERT_TRUE(interpolate(line, 10, 2, T));
  EXPECT_EQ(T.t.x(), 0);
  ASSERT_TRUE(interpolate(line, 20, 2, T)) << "an exact time needs no neighbour";
  EXPECT_FALSE(interpolate(line, 15, 2, T)) << "a gap";
  EXPECT_FALSE(interpolate(line, 9.99, 2, T));
  EXPECT_FALSE(interpolate(line, 20.01, 2, T));
  EXPECT_FALSE(interpolate({}, 1, 2, T));
}

TEST(Text, NumbersFillTheWord) {
  EXPECT_EQ(*to_number("+1.5e3"), 1500);
  for (const char* bad : {"", "1x", "x", "1,5", "0x10", " 1", "--1", "+"}) EXPECT_FALSE(to_number(bad)) << bad;
}

TEST(Text, RandomBytesNeverCrash) {
  const Folder folder;
  std::mt19937 random(3);
  for (int i = 0; i < 300; ++i) {
    std::string bytes = i % 2 ? "u,v,depth\n" : "";
    for (int n = static_cast<int>(random() % 400); n > 0; --n) bytes += "0123456789.,-: \n[]#auvdepth\xff\0"[random() % 29];
    const std::string path = folder.write("x", bytes);
    try {
      load_features(path);
    } catch (const Error&) {
    }
    try {
      load_trajectory(path);
    } catch (const Error&) {
    }
    try {
      load_pose(path, "pose");
    } catch (const Error&) {
    }
  }
}

}  // namespace
}  // namespace iclk
