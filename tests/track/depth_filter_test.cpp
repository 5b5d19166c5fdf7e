// Depths by motion: what one frame says, what many say together, and the search along an epipolar line.
#include <cmath>
#include <random>

#include <gtest/gtest.h>
#include <Eigen/Geometry>
#include <Eigen/LU>

#include <iclk/track/internal/depth_filter.h>
#include <iclk/track/internal/epipolar_search.h>

#include "relief.h"

namespace iclk::test {
namespace {

using namespace internal;

const Camera kCamera{500, 480, 319.5, 239.5, 640, 480};

SE3 moved(const Eigen::Vector3d& t, const Eigen::Vector3d& turn) { return SE3::exp((Vector6d() << t, turn).finished()); }

TEST(DepthFilter, TriangulationIsExactAndItsSigmaTheDifferenceQuotients) {
  const SE3 T = moved({0.2, -0.05, 0.1}, {0.02, -0.05, 0.03});
  const Eigen::Vector2d uv0(200, 300);
  const double q = 0.4;
  const Eigen::Vector2d uv1 = kCamera.project(T * (kCamera.ray(uv0) / q));
  Eigen::Matrix2d covariance;
  covariance << 0.3, 0.1, 0.1, 0.2;
  Matrix6d C = 1e-6 * Matrix6d::Identity();
  C(0, 4) = C(4, 0) = 4e-7;
  const auto exact = triangulate(kCamera, uv0, T, uv1, covariance, C);
  ASSERT_TRUE(exact);
  EXPECT_NEAR(exact->inverse_depth, q, 1e-12);
  EXPECT_NEAR(exact->off_line, 0, 1e-6);
  // Through the estimate itself: of the position, and of a pose that is another than was said.
  const double h = 1e-4;
  Eigen::Vector2d of_uv;
  for (int i = 0; i < 2; ++i)
    of_uv[i] = (triangulate(kCamera, uv0, T, uv1 + h * Eigen::Vector2d::Unit(i), covariance, C)->inverse_depth -
                triangulate(kCamera, uv0, T, uv1 - h * Eigen::Vector2d::Unit(i), covariance, C)->inverse_depth) /
               (2 * h);
  Vector6d of_pose;
  for (int i = 0; i < 6; ++i)
    of_pose[i] = (triangulate(kCamera, uv0, T * SE3::exp(h * Vector6d::Unit(i)), uv1, covariance, C)->inverse_depth -
                  triangulate(kCamera, uv0, T * SE3::exp(-h * Vector6d::Unit(i)), uv1, covariance, C)->inverse_depth) /
                 (2 * h);
  EXPECT_NEAR(exact->sigma, std::sqrt(of_uv.dot(covariance * of_uv) + of_pose.dot(C * of_pose)), 1e-4 * exact->sigma);
  EXPECT_GT(exact->sigma, triangulate(kCamera, uv0, T, uv1, covariance)->sigma);
  // What moves off the line by three standard deviations says so, and changes the depth little.
  const double moves = parallax(kCamera, uv0, q, T);
  EXPECT_NEAR(moves, (kCamera.project(T * (kCamera.ray(uv0) / (q + h))) - uv1).norm() / h, 0.01 * moves);
  const Eigen::Vector2d along = (kCamera.project(T * (kCamera.ray(uv0) / (q + 0.01))) - uv1).normalized();
  const auto off = triangulate(kCamera, uv0, T, uv1 + 3 * Eigen::Vector2d(-along.y(), along.x()), Eigen::Matrix2d::Identity());
  EXPECT_NEAR(off->off_line, 3, 0.05);
  EXPECT_NEAR(off->inverse_depth, q, 0.01 * q);
}

TEST(DepthFilter, WhatCannotBeTriangulatedIsNot) {
  const Eigen::Vector2d uv(200, 300);
  const Eigen::Matrix2d I = Eigen::Matrix2d::Identity();
  EXPECT_FALSE(triangulate(kCamera, uv, moved({0, 0, 0}, {0, 0.1, 0}), uv, I));  // pure rotation
  EXPECT_FALSE(triangulate(kCamera, uv, SE3(), uv, I));                          // none
  EXPECT_FALSE(triangulate(kCamera, uv, moved({0.1, 0, 0}, {0, 0, 0}), {NAN, 300}, I));
  EXPECT_FALSE(triangulate(kCamera, uv, moved({0.1, 0, 0}, {0, 3.1, 0}), uv, I));  // looks the other way
  // Noise may put it beyond infinity, which is a measurement of far away.
  const auto far = triangulate(kCamera, uv, moved({0.1, 0, 0}, {0, 0, 0}), uv - Eigen::Vector2d(0.5, 0), I);
  ASSERT_TRUE(far);
  EXPECT_LT(far->inverse_depth, 0);
  EXPECT_EQ(parallax(kCamera, uv, 0.5, moved({0, 0, -3}, {0, 0, 0})), 0);
}

TEST(DepthFilter, FindsTheDepthAmongWrongSightings) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> share(0, 1), anywhere(0.1, 1.1);
  std::normal_distribution<double> normal;
  int within = 0, kept = 0;
  double shares = 0, error = 0, mean_error = 0;
  constexpr int kSeeds = 300, kFrames = 40;
  for (int i = 0; i < kSeeds; ++i) {
    const double q = 0.2 + 0.8 * share(random);
    DepthFilter filter = DepthFilter::between(0.1, 1.1);
    EXPECT_DOUBLE_EQ(filter.mean, 0.6);
    double sum = 0;
    for (int k = 0; k < kFrames; ++k) {
      const double tau = 0.01 + 0.03 * share(random);  // less as the camera gets farther
      const double x = share(random) < 0.3 ? anywhere(random) : q + tau * normal(random);
      filter.add(x, tau);
      sum += x / kFrames;
    }
    if (filter.inlier_share() < 0.5) continue;  // held to a wrong one: it is not believed
    ++kept;
    within += std::abs(filter.mean - q) < 3 * filter.sigma;
    shares += filter.inlier_share();
    error += std::abs(filter.mean - q);
    mean_error += std::abs(sum - q);
  }
  EXPECT_GT(kept, 0.95 * kSeeds);
  EXPECT_GT(within, 0.95 * kept);
  EXPECT_NEAR(shares / kept, 0.7, 0.08);
  EXPECT_LT(error / kept, 0.006);  // some tau / sqrt(28)
  EXPECT_GT(mean_error / kept, 8 * error / kept);
}

TEST(DepthFilter, WhatIsNeverTheSameIsNotBelieved) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> anywhere(0.1, 1.1);
  int believed = 0;
  for (int i = 0; i < 100; ++i) {
    DepthFilter filter = DepthFilter::between(0.1, 1.1);
    for (int k = 0; k < 30; ++k) filter.add(anywhere(random), 0.01);
    believed += filter.inlier_share() > 0.55;
    DepthFilter unseen = DepthFilter::between(0.1, 1.1);
    for (int k = 0; k < 7; ++k) unseen.miss();
    EXPECT_LT(unseen.inlier_share(), 0.3);
  }
  EXPECT_LE(believed, 2);
}

struct Sideways {
  Relief relief;
  Pyramid f0, f1;
  explicit Sideways(double t = 0.5) {
    relief.T_10 = moved({t, 0.1, -0.05}, {0.01, -0.02, 0.03});
    f0 = grey_pyramid(render(relief, 0).view(), 2);
    f1 = grey_pyramid(render(relief, 1).view(), 2);
  }
  std::optional<AlignedFeature> search(const Eigen::Vector2d& uv, double low, double high) const {
    return search_epipolar(f0, f1, relief.camera, uv, low, high, relief.T_10);
  }
};

TEST(EpipolarSearch, FindsFeaturesOfWhichLittleIsKnown) {
  const Sideways s;
  const Features features = random_features(s.relief, 60, 3, 30);
  int found = 0;
  double off = 0, wrong = 0;
  for (const Eigen::Vector2d& uv : features.uv) {
    const auto f = s.search(uv, 0.12, 0.5);  // 25 px of line
    if (!f) continue;
    ++found;
    EXPECT_LT((f->uv1 - s.relief.truth(uv)).norm(), 1);  // patches lie on slopes
    off += (f->uv1 - s.relief.truth(uv)).norm();
    const auto seen = triangulate(s.relief.camera, uv, s.relief.T_10, f->uv1, 0.01 * Eigen::Matrix2d::Identity());
    ASSERT_TRUE(seen);
    wrong += std::abs(seen->inverse_depth * s.relief.depth(uv) - 1);
  }
  EXPECT_GT(found, 40);
  EXPECT_LT(off / found, 0.3);
  EXPECT_LT(wrong / found, 0.02);
}

TEST(EpipolarSearch, SaysNothingWhereItCannotKnow) {
  Sideways s;
  const Eigen::Vector2d uv(80, 60);
  ASSERT_TRUE(s.search(uv, 0.12, 0.5));
  EXPECT_FALSE(s.search(uv, 0.12, 8));  // hundreds of px
  // The place looks the same every 12 px of the line.
  Relief waves = s.relief;
  waves.T_10 = moved({0.5, 0, 0}, {0, 0, 0});
  Frame again{160, 120, std::vector<float>(160 * 120)};
  for (int v = 0; v < 120; ++v)
    for (int u = 0; u < 160; ++u)
      again.at(u, v) = static_cast<float>(0.5 + 0.2 * std::sin(2 * M_PI * u / 12) + 0.2 * std::sin(0.5 * v));
  const Pyramid same = grey_pyramid(again.view(), 2);
  EXPECT_FALSE(search_epipolar(same, same, waves.camera, uv, 0.12, 0.6, waves.T_10));
  // Hidden.
  const std::vector<uint8_t> none(160 * 120, 0);
  hide(s.f1, {none.data(), 160, 120, 0, PixelFormat::r8});
  EXPECT_FALSE(s.search(uv, 0.12, 0.5));
}

}  // namespace
}  // namespace iclk::test
