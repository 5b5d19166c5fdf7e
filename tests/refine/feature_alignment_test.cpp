#include <cmath>
#include <limits>

#include <gtest/gtest.h>
#include <iclk/align/pyramid.h>
#include <iclk/engine/error.h>
#include <iclk/refine/internal/align_feature.h>
#include <Eigen/LU>

#include "../support/synthetic.h"

namespace iclk {
namespace {

using internal::align_feature;
using internal::PatchWarp;
using internal::warp_patch;
using test::Scene;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

SE3 motion(double roll = 0.15) {
  Vector6d xi;
  xi << 1.2, -0.8, 0.9, 0.006, -0.009, roll;
  return SE3::exp(xi);
}

struct Pyramids {
  Pyramid f0, f1;
  explicit Pyramids(const Scene& scene, uint32_t noise_seed = 0, int levels = 2)
      : f0(grey_pyramid(test::render(scene, 0, noise_seed).view(), levels)),
        f1(grey_pyramid(test::render(scene, 1, noise_seed).view(), levels)) {}
};

struct Errors {
  int aligned = 0;
  double rms = 0, largest = 0, nees = 0;  // nees per degree of freedom: 1 for an honest covariance
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
};

Errors errors(const Scene& scene, const Pyramids& p, const Features& f, const SE3& guess,
              const FeatureAlignmentOptions& options = {}, int level = 0) {
  Errors e;
  for (int i = 0; i < f.size(); ++i) {
    const AlignedFeature a = align_feature(p.f0, p.f1, scene.camera, f.uv[i], f.inverse_depth[i], guess, options, level);
    if (a.status != FeatureStatus::aligned) continue;
    const Eigen::Vector2d d = a.uv1 - scene.truth(f.uv[i]);
    ++e.aligned;
    e.rms += d.squaredNorm();
    e.largest = std::max(e.largest, d.norm());
    e.mean += d;
    e.nees += d.dot(a.covariance.inverse() * d) / 2;
  }
  if (e.aligned == 0) return e;
  e.rms = std::sqrt(e.rms / e.aligned);
  e.mean /= e.aligned;
  e.nees /= e.aligned;
  return e;
}

SE3 off_by(const Scene& scene, double du, double dv) {
  Vector6d xi = Vector6d::Zero();
  xi[4] = du / scene.camera.fx;
  xi[3] = -dv / scene.camera.fy;
  return scene.T_10 * SE3::exp(xi);
}

TEST(FeatureAlignment, FindsRotatedPatchesUnderGainAndBias) {
  Scene scene;
  scene.T_10 = motion();
  scene.gain = 1.3;
  scene.bias = -0.1;
  const Pyramids p(scene);
  const Features f = test::random_features(scene, 200, 5);
  const Errors e = errors(scene, p, f, off_by(scene, 0.8, -0.6));
  EXPECT_GE(e.aligned, 195);
  EXPECT_LT(e.rms, 0.03);  // what bilinear interpolation leaves on this texture
  EXPECT_LT(e.largest, 0.12);
  EXPECT_LT(e.mean.norm(), 0.005);  // no bias: conventions of patch centre and pixel centre agree
  for (int i = 0; i < f.size(); ++i) {
    const AlignedFeature a = align_feature(p.f0, p.f1, scene.camera, f.uv[i], f.inverse_depth[i], scene.T_10);
    if (a.status != FeatureStatus::aligned) continue;
    EXPECT_NEAR(a.gain, 1.3, 0.1);
    EXPECT_NEAR(a.gain * 0.5 + a.bias, 1.3 * 0.5 - 0.1, 0.02);
    EXPECT_GT(a.correlation, 0.98);
  }
}

TEST(FeatureAlignment, FindsPatchesOfNoisyImagesAtHalfTheSize) {
  Scene scene;
  scene.T_10 = motion();
  scene.gain = 1.3;
  scene.noise = 0.15;
  const Features f = test::random_features(scene, 200, 10);
  const Pyramids p(scene, 1);
  const Errors whole = errors(scene, p, f, scene.T_10), half = errors(scene, p, f, scene.T_10, {}, 1);
  EXPECT_GT(half.aligned, 2 * whole.aligned);
  EXPECT_GT(half.aligned, 100);
  EXPECT_LT(half.rms, 0.7);
  EXPECT_LT(half.mean.norm(), 0.05);  // pixel centres: half a pixel would show
  EXPECT_GT(half.nees, 0.5);
  EXPECT_LT(half.nees, 2);
  scene.noise = 0;
  const Errors clean = errors(scene, Pyramids(scene), f, off_by(scene, 2, -1), {}, 1);
  EXPECT_GE(clean.aligned, 195);
  EXPECT_LT(clean.rms, 0.06);
  EXPECT_LT(clean.mean.norm(), 0.01);
  EXPECT_EQ(errors(scene, Pyramids(scene, 0, 1), f, scene.T_10, {}, 1).aligned, 0) << "a pyramid of one level";
}

TEST(FeatureAlignment, IsExactAtSubPixelPlacesOfTheSameImage) {
  Scene scene;
  const Pyramids p(scene);
  const Features f = test::random_features(scene, 50, 3);
  for (int i = 0; i < f.size(); ++i) {
    const AlignedFeature a = align_feature(p.f0, p.f0, scene.camera, f.uv[i], f.inverse_depth[i], SE3{});
    ASSERT_EQ(a.status, FeatureStatus::aligned);
    EXPECT_LT((a.uv1 - f.uv[i]).norm(), 1e-9);
    EXPECT_NEAR(a.gain, 1, 1e-9);
    EXPECT_NEAR(a.bias, 0, 1e-9);
    EXPECT_NEAR(a.correlation, 1, 1e-9);
  }
}

TEST(FeatureAlignment, CameraWithNegativeFocalLength) {
  Scene scene;
  scene.camera.fy = -scene.camera.fy;
  scene.T_10 = motion(0.05);
  const Errors e = errors(scene, Pyramids(scene), test::random_features(scene, 60, 5), off_by(scene, 1, 1));
  EXPECT_GE(e.aligned, 57);
  EXPECT_LT(e.rms, 0.03);
}

TEST(FeatureAlignment, CovarianceIsThatOfTheErrors) {
  // Noise of 0.01 is far above what interpolation does; the mean over noise and features of e^T C^-1 e / 2 is 1 for a perfect
  // C.
  Scene scene;
  scene.T_10 = motion();
  scene.noise = 0.01;
  scene.gain = 1.3;
  scene.bias = -0.1;
  const Features f = test::random_features(scene, 100, 9);
  double nees = 0;
  const int runs = 12;
  for (int run = 0; run < runs; ++run) {
    const Errors e = errors(scene, Pyramids(scene, 1 + run), f, scene.T_10);
    ASSERT_GE(e.aligned, 95);
    nees += e.nees / runs;
  }
  RecordProperty("nees", std::to_string(nees));
  EXPECT_GT(nees, 0.7);
  EXPECT_LT(nees, 1.3);
}

TEST(FeatureAlignment, LevelOneWidensTheBasin) {
  Scene scene;
  scene.camera = {225.6, 225.6, 187.5, 119.5, 376, 240};
  scene.T_10 = motion();
  const Pyramids p(scene);
  const Features f = test::random_features(scene, 150, 5, 30);
  Pyramids level_0 = p;
  level_0.f0.resize(1);
  const SE3 off = off_by(scene, 5, -4);
  EXPECT_GT(errors(scene, p, f, off).aligned, errors(scene, level_0, f, off).aligned + 15);
  EXPECT_LT(errors(scene, p, f, scene.T_10).rms, 0.03);
}

TEST(FeatureAlignment, AWrongWarpTurnsThePatchAboutTheFeature) {
  Scene scene;
  const Pyramids p(scene);
  Vector6d roll = Vector6d::Zero();
  roll[5] = 0.15;
  Features f = test::random_features(scene, 3000, 3);
  Eigen::Vector2d mean(0, 0);
  int n = 0;
  for (int i = 0; i < f.size(); ++i) {
    const SE3 T = SE3::exp(roll);
    const Eigen::Vector3d X = scene.camera.ray(f.uv[i]) * scene.depth(f.uv[i]);
    const SE3 about_feature{T.R, X - T.R * X};  // projects the feature to the right place with a patch that is rolled
    const AlignedFeature a = align_feature(p.f0, p.f0, scene.camera, f.uv[i], f.inverse_depth[i], about_feature);
    if (a.status != FeatureStatus::aligned) continue;
    mean += a.uv1 - f.uv[i];
    ++n;
  }
  ASSERT_GT(n, 1000);
  RecordProperty("mean", std::to_string((mean / n).norm()));
  EXPECT_LT((mean / n).norm(), 0.03);  // half a pixel off centre would move it by 0.15 * 0.5 * sqrt(2) = 0.1
}

TEST(FeatureAlignment, WarpDerivativeAgreesWithFiniteDifferences) {
  Scene scene;
  scene.T_10 = motion(0.4);
  const Eigen::Vector2d uv0(40.3, 70.8);
  const double q = 1 / scene.depth(uv0), h = 1e-4;
  const PatchWarp w = warp_patch(scene.camera, uv0, q, scene.T_10);
  ASSERT_TRUE(w.valid);
  for (int k = 0; k < 2; ++k) {
    const Eigen::Vector2d d = h * Eigen::Vector2d::Unit(k);
    const Eigen::Vector2d numeric =
        (warp_patch(scene.camera, uv0 + d, q, scene.T_10).uv1 - warp_patch(scene.camera, uv0 - d, q, scene.T_10).uv1) / (2 * h);
    EXPECT_LT((w.A.col(k) - numeric).norm(), 1e-7);
  }
}

TEST(FeatureAlignment, NamesWhyAFeatureWasNotAligned) {
  Scene scene;
  scene.T_10 = motion();
  const Pyramids p(scene);
  const Eigen::Vector2d uv0(90.4, 60.2);
  const double q = 1 / scene.depth(uv0);
  const auto status = [&](const Pyramid& f0, const Pyramid& f1, const Eigen::Vector2d& uv, const SE3& T,
                          const FeatureAlignmentOptions& o = {}) {
    return align_feature(f0, f1, scene.camera, uv, q, T, o).status;
  };
  ASSERT_EQ(status(p.f0, p.f1, uv0, scene.T_10), FeatureStatus::aligned);

  Pyramid flat = p.f0;
  for (Map& m : flat) std::fill(m.data.begin(), m.data.end(), 0.5f);
  EXPECT_EQ(status(flat, p.f1, uv0, scene.T_10), FeatureStatus::low_texture);
  Pyramid edge = p.f0;  // a straight edge determines one direction only
  for (Map& m : edge)
    for (int v = 0; v < m.height; ++v)
      for (int u = 0; u < m.width; ++u) m.at(u, v) = u > m.width * 0.48 ? 0.8f : 0.2f;
  EXPECT_EQ(status(edge, edge, uv0, SE3{}), FeatureStatus::low_texture);

  SE3 away;
  away.t = Eigen::Vector3d(200, 0, 0);
  EXPECT_EQ(status(p.f0, p.f1, uv0, away), FeatureStatus::out_of_image);
  SE3 behind;
  behind.t = Eigen::Vector3d(0, 0, -200);
  EXPECT_EQ(status(p.f0, p.f1, uv0, behind), FeatureStatus::out_of_image);
  EXPECT_EQ(status(p.f0, p.f1, {0.5, 0.5}, scene.T_10), FeatureStatus::out_of_image);  // patch leaves image 0

  EXPECT_EQ(status(p.f0, flat, uv0, scene.T_10), FeatureStatus::diverged);  // nothing to hold on to in the target

  FeatureAlignmentOptions hasty;  // ends before the steps do
  hasty.iterations = 1;
  EXPECT_EQ(status(p.f0, p.f1, uv0, off_by(scene, 1, 1), hasty), FeatureStatus::diverged);
  FeatureAlignmentOptions near = {};
  near.max_motion = 0.5;
  EXPECT_EQ(status(p.f0, p.f1, uv0, off_by(scene, 1, 1), near), FeatureStatus::diverged);

  EXPECT_EQ(align_feature(p.f0, p.f1, scene.camera, uv0, 0, scene.T_10).status, FeatureStatus::rejected);
  EXPECT_EQ(align_feature(p.f0, p.f1, scene.camera, {kNaN, 3}, q, scene.T_10).status, FeatureStatus::rejected);
  EXPECT_EQ(align_feature({}, p.f1, scene.camera, uv0, q, scene.T_10).status, FeatureStatus::rejected);
}

TEST(FeatureAlignment, RarelyMatchesAnUnrelatedTarget) {
  Scene scene, other;
  scene.shortest = other.shortest = 5;
  other.seed = 77;
  const Pyramids p(scene), o(other);
  const Features f = test::random_features(scene, 300, 2);
  int aligned = 0, bad = 0, diverged = 0;
  for (int i = 0; i < f.size(); ++i) {
    const auto s = align_feature(p.f0, o.f0, scene.camera, f.uv[i], f.inverse_depth[i], SE3{}).status;
    aligned += s == FeatureStatus::aligned;
    bad += s == FeatureStatus::bad_match;
    diverged += s == FeatureStatus::diverged;
  }
  EXPECT_LT(aligned, 45);  // gain, bias and 8 px of search make some smooth patches alike; the pose has to weed them out
  EXPECT_GT(bad, 0);
  EXPECT_GT(diverged, 0);
}

TEST(FeatureAlignment, HostileInputEndsInAStatusAndFiniteNumbers) {
  Scene scene;
  scene.T_10 = motion();
  Pyramids p(scene);
  Pyramid nan = p.f1, inf = p.f1;
  for (Map& m : nan) std::fill(m.data.begin(), m.data.end(), std::numeric_limits<float>::quiet_NaN());
  for (Map& m : inf)
    for (size_t i = 0; i < m.data.size(); i += 3) m.data[i] = std::numeric_limits<float>::infinity();
  SE3 bad_pose;
  bad_pose.t.x() = kNaN;
  SE3 far_pose;
  far_pose.t.x() = 1e300;
  const Eigen::Vector2d uv0(90.4, 60.2);
  const Pyramid* maps[] = {&p.f0, &p.f1, &nan, &inf};
  for (const Pyramid* f0 : maps)
    for (const Pyramid* f1 : maps)
      for (const SE3& T : {scene.T_10, bad_pose, far_pose})
        for (double q : {0.0125, 1e-300, 1e300, kInf, kNaN, -1.0}) {
          const AlignedFeature a = align_feature(*f0, *f1, scene.camera, uv0, q, T);
          EXPECT_TRUE(a.uv1.allFinite() && a.covariance.allFinite() && std::isfinite(a.gain) && std::isfinite(a.bias) &&
                      std::isfinite(a.correlation));
          if (f0 == &nan || f1 == &nan || !T.t.allFinite() || !std::isfinite(q)) {
            EXPECT_NE(a.status, FeatureStatus::aligned);
          }
        }
}

TEST(FeatureAlignment, OptionsNameTheValueThatIsWrong) {
  FeatureAlignmentOptions options;
  options.check();
  options.min_correlation = kNaN;
  try {
    options.check();
    FAIL() << "NaN was accepted";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::invalid_argument);
    EXPECT_NE(std::string(e.what()).find("min_correlation"), std::string::npos);
  }
  options = {};
  options.iterations = 0;
  EXPECT_THROW(options.check(), Error);
}

TEST(FeatureAlignment, SummaryCountsEveryStatus) {
  std::vector<AlignedFeature> f(4);
  f[0].status = FeatureStatus::aligned;
  f[1].status = FeatureStatus::bad_match;
  f[2].status = FeatureStatus::low_texture;
  EXPECT_EQ(summary(f), "1 of 4 features aligned (1 low_texture, 1 bad_match, 1 rejected)");
}

}  // namespace
}  // namespace iclk
