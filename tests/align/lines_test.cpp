// Starts by the lines of whole images: fields whose borders stay, while each has another brightness.
#include <random>

#include <gtest/gtest.h>
#include <iclk/align/common/input.h>
#include <iclk/align/search/gradients.h>
#include <iclk/align/search/line_patches.h>
#include <iclk/align/search/lines.h>
#include <Eigen/Geometry>

#include "../support/relief.h"

namespace iclk::test {
namespace {

using Eigen::Vector2d;
using internal::Similarity;

const Camera kCamera{260, 260, 159.5, 119.5, 320, 240};

Similarity motion_of(double roll, double scale, const Vector2d& shift) { return {roll, scale, {159.5, 119.5}, shift}; }

/// The image of fields in the year `year`, moved. Every pixel belongs to the field of the nearest of 90 random points.
Frame fields(uint32_t place, uint32_t year, const Similarity& motion = motion_of(0, 1, {0, 0})) {
  std::mt19937 where(place), grey(year);
  std::vector<Vector2d> points;
  std::vector<float> greys;
  for (int i = 0; i < 90; ++i) {
    points.push_back(Vector2d(where() % 600, where() % 500) - Vector2d(140, 130));
    greys.push_back(0.2f + 0.6f * static_cast<float>(grey() % 1000) / 1000);
  }
  Frame frame{kCamera.width, kCamera.height, std::vector<float>(static_cast<size_t>(kCamera.width * kCamera.height))};
  const Eigen::Matrix2d back = Eigen::Rotation2Dd(-motion.roll).toRotationMatrix() / motion.scale;
  for (int v = 0; v < frame.height; ++v)
    for (int u = 0; u < frame.width; ++u) {
      const Vector2d at = motion.centre + back * (Vector2d(u, v) - motion.shift - motion.centre);
      size_t nearest = 0;
      for (size_t i = 1; i < points.size(); ++i)
        if ((points[i] - at).squaredNorm() < (points[nearest] - at).squaredNorm()) nearest = i;
      frame.at(u, v) = greys[nearest];
    }
  return frame;
}

constexpr int kScale = 4;  // pixels of the image per pixel of the maps

std::optional<Similarity> match(const Frame& image0, const Frame& image1, int threads = 1) {
  return internal::match_lines(internal::lines_of(grey_map(image0.view()), kScale),
                               internal::lines_of(grey_map(image1.view()), kScale), threads);
}

/// px of the image, at a pixel of image 0.
double error(const Similarity& found, const Similarity& truth, const Vector2d& at) {
  const Vector2d place = found((at.array() + 0.5) / kScale - 0.5);
  return ((place.array() + 0.5) * kScale - 0.5 - truth(at).array()).matrix().norm();
}

TEST(Lines, FindTheMotionOfAnImage) {
  for (const double degrees : {0, 10, -95, 180})
    for (const double scale : {1.0, 1.1}) {
      const Similarity truth = motion_of(degrees * M_PI / 180, scale, {40, -24});
      const auto found = match(fields(1, 1), fields(1, 2, truth));
      ASSERT_TRUE(found) << degrees << ", " << scale;
      for (const Vector2d& at : {Vector2d(60, 50), Vector2d(260, 190)})
        EXPECT_LT(error(*found, truth, at), 12) << degrees << ", " << scale;
    }
}

TEST(Lines, FindNothingWhereNothingIsClear) {
  const Frame flat{320, 240, std::vector<float>(320 * 240, 0.5f)}, nan{320, 240, std::vector<float>(320 * 240, NAN)};
  const Frame known = fields(1, 1);
  EXPECT_FALSE(match(known, fields(2, 1))) << "another place";
  for (const Frame& other : {flat, nan}) {
    EXPECT_FALSE(match(known, other));
    EXPECT_FALSE(match(other, known));
  }
  EXPECT_FALSE(match(chequered(320, 240, 0, 1), chequered(320, 240, 5, 2))) << "a wall that repeats";
}

TEST(Lines, ThreadsChangeNothing) {
  const Frame image0 = fields(1, 1), image1 = fields(1, 2, motion_of(0.1, 1, {20, 8}));
  const auto one = match(image0, image1), three = match(image0, image1, 3);
  ASSERT_TRUE(one && three);
  EXPECT_EQ(one->roll, three->roll);
  EXPECT_EQ(one->scale, three->scale);
  EXPECT_EQ(one->shift, three->shift);
}

/// Level fields, seen from above in two years.
struct TwoYears {
  explicit TwoYears(uint32_t place, double roll = 0.15)
      : motion(motion_of(roll, 1, {36, -20})), image0(fields(place, 1)), image1(fields(place, 2, motion)) {
    for (int v = 30; v < 220; v += 18)
      for (int u = 30; u < 300; u += 20) features.uv.emplace_back(u, v), features.inverse_depth.push_back(1 / depth);
    reference = {image0.view(), kCamera, features, {}};
    checks = check_features(features, kCamera);
    truth.R = Eigen::AngleAxisd(motion.roll, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    truth.t << depth * motion.shift.x() / kCamera.fx, depth * motion.shift.y() / kCamera.fy, 0;
  }
  /// px, mean of the features.
  double error(const SE3& T_10) const {
    double sum = 0;
    for (const Vector2d& uv : features.uv) {
      const Eigen::Vector3d X = kCamera.ray(uv) * depth;
      sum += (kCamera.project(T_10 * X) - kCamera.project(truth * X)).norm();
    }
    return sum / static_cast<double>(features.size());
  }

  const double depth = 4;
  const Similarity motion;
  Frame image0, image1;
  Features features;
  Reference reference;
  std::vector<FeatureCheck> checks;
  SE3 truth;
};

TEST(Lines, FindAStartWherePatchesDoNot) {
  for (uint32_t place = 1; place <= 3; ++place) {
    const TwoYears s(place);
    const auto start = internal::start_by_gradients(s.reference, s.checks, {0, s.image1.view()}, 1);
    ASSERT_TRUE(start) << place;
    EXPECT_LT(s.error(*start), 1) << place;
  }
}

TEST(LinePatches, FindThePoseNearAnother) {
  const TwoYears s(1, 1);
  const Pair pair{0, s.image1.view()};
  SE3 near = s.truth;
  near.t.x() += 0.12;
  ASSERT_NEAR(s.error(near), 7.8, 0.1);
  internal::PairLines lines(s.reference, pair);
  const internal::LineRound rounds[] = {{2, 8}, {1, 4}};
  const auto found = internal::match_line_patches(s.reference, s.checks, lines, near, rounds, 1);
  ASSERT_TRUE(found);
  EXPECT_LT(s.error(found->T_10), 0.5);
  EXPECT_GT(found->share(), 0.5);
  const auto threads = internal::match_line_patches(s.reference, s.checks, lines, near, rounds, 3);
  EXPECT_EQ(threads->T_10.matrix(), found->T_10.matrix());
  const internal::LineRound strict[] = {{2, 8}, {1, 4, found->share() + 0.1}};
  EXPECT_FALSE(internal::match_line_patches(s.reference, s.checks, lines, near, strict, 1)) << "too few agree";
  const internal::LineRound narrow[] = {{1, 4}};
  EXPECT_FALSE(internal::match_line_patches(s.reference, s.checks, lines, near, narrow, 1)) << "it is farther away";
}

TEST(LinePatches, FindNothingWhereNothingIs) {
  const TwoYears s(1);
  const Frame other = fields(9, 1), nan{320, 240, std::vector<float>(320 * 240, NAN)};
  const internal::LineRound rounds[] = {{2, 8}, {1, 4}};
  const auto match = [&](const Pair& pair, std::span<const FeatureCheck> checks, const SE3& start) {
    internal::PairLines lines(s.reference, pair);
    return internal::match_line_patches(s.reference, checks, lines, start, rounds, 1).has_value();
  };
  EXPECT_TRUE(match({0, s.image1.view()}, s.checks, s.truth));
  EXPECT_FALSE(match({0, other.view()}, s.checks, s.truth));
  EXPECT_FALSE(match({0, nan.view()}, s.checks, s.truth));
  EXPECT_FALSE(match({0, s.image1.view()}, std::vector(s.features.size(), FeatureCheck::no_depth), s.truth));
  const std::vector<uint8_t> hidden(320 * 240, 0);
  Pair masked{0, s.image1.view()};
  masked.target_mask = {hidden.data(), 320, 240, 0, PixelFormat::r8};
  EXPECT_FALSE(match(masked, s.checks, s.truth));
  SE3 behind = s.truth;
  behind.t.z() = -9;
  EXPECT_FALSE(match({0, s.image1.view()}, s.checks, behind));
  SE3 broken = s.truth;
  broken.t.x() = NAN;
  EXPECT_FALSE(match({0, s.image1.view()}, s.checks, broken));
}

TEST(Lines, OfHiddenPixelsAreNone) {
  Map grey = grey_map(fields(1, 1).view());
  for (int v = 0; v < grey.height; ++v)
    for (int u = 0; u < grey.width / 2; ++u) grey.at(u, v) = v % 2 ? kHidden : NAN;
  const internal::Lines lines = internal::lines_of(grey, 4);
  EXPECT_TRUE(lines.real().allFinite() && lines.imag().allFinite());
  EXPECT_EQ(lines.leftCols(grey.width / 8).norm(), 0);
  EXPECT_GT(lines.rightCols(grey.width / 8 - 1).norm(), 0);
}

}  // namespace
}  // namespace iclk::test
