// Motion blur: found from the spectra of both images, and matched. The blur of these scenes is made here: the mean of many
// shifted views.
#include <cmath>
#include <limits>

#include <gtest/gtest.h>
#include <iclk/align/aligner.h>
#include <iclk/refine/cascade.h>
#include <iclk/refine/internal/blur.h>

#include "../support/relief.h"

namespace iclk {
namespace {

using Eigen::Vector2d;
using test::Frame;
using test::Relief;

Map map_of(const Frame& frame) { return grey_map(frame.view()); }

/// The mean along a centred line, by 41 bilinear views.
Frame moved(const Frame& sharp, const Vector2d& line) {
  constexpr int kViews = 41;
  const Map map = map_of(sharp);
  Frame out = sharp;
  for (int v = 0; v < out.height; ++v)
    for (int u = 0; u < out.width; ++u) {
      double sum = 0;
      for (int k = 0; k < kViews; ++k) {
        const Vector2d at = Vector2d(u, v) + ((k + 0.5) / kViews - 0.5) * line;
        sum += map.bilinear(at.x(), at.y());
      }
      out.at(u, v) = static_cast<float>(sum / kViews);
    }
  return out;
}

/// Texture from 3 to 100 px, seen from two places, with noise.
struct Scene {
  explicit Scene(uint32_t seed = 1) {
    relief.camera = {300, 300, 159.5, 119.5, 320, 240};
    relief.seed = seed;
    relief.shortest = 3;
    relief.longest = 100;
    relief.waves = 160;
    relief.contrast = 0.02;
    relief.depth_amplitude = 0.1;
    Vector6d xi;
    xi << 0.05, -0.03, 0.02, 0.01, 0.02, 0.03;
    relief.T_10 = SE3::exp(xi);
    image0 = test::render(relief, 0);
    image1 = test::render(relief, 1);
    features = test::random_features(relief, 80);
  }
  void blur(const Vector2d& line0, const Vector2d& line1) {
    if (!line0.isZero()) image0 = moved(image0, line0);
    if (!line1.isZero()) image1 = moved(image1, line1);
    std::mt19937 random(5);
    std::normal_distribution<float> noise(0, 0.004f);
    for (Frame* frame : {&image0, &image1})
      for (float& x : frame->data) x += noise(random);
  }
  std::optional<internal::PairBlur> found(const SE3& T_10) const {
    return internal::find_blur(map_of(image0), map_of(image1), relief.camera, features, T_10);
  }
  std::optional<internal::PairBlur> found() const { return found(relief.T_10); }

  Relief relief;
  Frame image0, image1;
  Features features;
};

double apart(const Vector2d& a, const Vector2d& b) { return std::min((a - b).norm(), (a + b).norm()); }

TEST(FindBlur, EachImageHasItsLine) {
  const Vector2d none = Vector2d::Zero();
  for (const auto& [line0, line1] : {std::pair(Vector2d(14, 5), none), std::pair(none, Vector2d(-3, 17)),
                                     std::pair(Vector2d(12, 12), Vector2d(9, -6)), std::pair(Vector2d(0, 8), none)}) {
    Scene scene;
    scene.blur(line0, line1);
    const auto blur = scene.found();
    ASSERT_TRUE(blur) << line0.transpose() << ", " << line1.transpose();
    EXPECT_LT(apart(blur->reference, line0), 3) << blur->reference.transpose() << " for " << line0.transpose();
    EXPECT_LT(apart(blur->target, line1), 3) << blur->target.transpose() << " for " << line1.transpose();
  }
}

TEST(FindBlur, ThePoseMayBeAFewPixelsOff) {
  Scene scene;
  scene.blur({15, 4}, Vector2d::Zero());
  SE3 off = scene.relief.T_10;
  off.t.x() += 3 * scene.relief.distance / scene.relief.camera.fx;  // 3 px
  const auto blur = scene.found(off);
  ASSERT_TRUE(blur);
  EXPECT_LT(apart(blur->reference, {15, 4}), 3) << blur->reference.transpose();
}

TEST(FindBlur, SharpOrEqualOrForeignImagesHaveNone) {
  Scene sharp, equal, foreign, hollow;
  sharp.blur(Vector2d::Zero(), Vector2d::Zero());
  EXPECT_FALSE(sharp.found());
  equal.blur({12, 4}, {12, 4});
  EXPECT_FALSE(equal.found());
  foreign.image1 = Scene(9).image1;
  foreign.blur(Vector2d::Zero(), Vector2d::Zero());
  EXPECT_FALSE(foreign.found());
  hollow.image1.data.assign(hollow.image1.data.size(), std::numeric_limits<float>::quiet_NaN());
  EXPECT_FALSE(hollow.found());
  hollow.image1.data.assign(hollow.image1.data.size(), 0.5f);
  EXPECT_FALSE(hollow.found());
}

TEST(FindBlur, BadFeaturesAreLeftOut) {
  Scene scene;
  scene.blur({14, 5}, Vector2d::Zero());
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (size_t i = 0; i < 40; ++i) {
    if (i % 2 == 0) scene.features.uv[i] = {nan, 1e300};
    if (i % 2 == 1) scene.features.inverse_depth[i] = i % 4 == 1 ? nan : -1;
  }
  const auto blur = scene.found();
  ASSERT_TRUE(blur);
  EXPECT_LT(apart(blur->reference, {14, 5}), 3);
  scene.features = {};
  EXPECT_FALSE(scene.found());
}

TEST(Blurred, MovesNothingAndKeepsTheMean) {
  Frame dot{31, 31, std::vector<float>(31 * 31, 0.0f)};
  dot.at(15, 15) = 1;
  const internal::FloatImage image = internal::blurred(dot.view(), {7.3, -4.1});
  double sum = 0, u_mean = 0, v_mean = 0, along = 0;
  for (int v = 0; v < 31; ++v)
    for (int u = 0; u < 31; ++u) {
      const double x = image.pixels[static_cast<size_t>(v) * 31 + static_cast<size_t>(u)];
      sum += x;
      u_mean += x * u;
      v_mean += x * v;
      along += x * std::pow((u - 15) * 7.3 + (v - 15) * -4.1, 2) / (7.3 * 7.3 + 4.1 * 4.1);
    }
  EXPECT_NEAR(sum, 1, 1e-5);
  EXPECT_NEAR(u_mean, 15, 1e-4);
  EXPECT_NEAR(v_mean, 15, 1e-4);
  EXPECT_NEAR(along, (7.3 * 7.3 + 4.1 * 4.1) / 12, 0.4);  // a uniform line; interpolation adds a third
}

TEST(Blurred, FormatsAreOneMeaning) {
  std::vector<uint8_t> bgr(3 * 12 * 9);
  for (size_t i = 0; i < bgr.size(); ++i) bgr[i] = static_cast<uint8_t>(37 * i);
  const internal::FloatImage image = internal::blurred({bgr.data(), 12, 9, 0, PixelFormat::bgr8}, Vector2d::Zero());
  ASSERT_EQ(image.view.format, PixelFormat::rgb32f);
  for (size_t i = 0; i < bgr.size(); i += 3)
    for (size_t c = 0; c < 3; ++c) EXPECT_NEAR(image.pixels[i + c], bgr[i + 2 - c] / 255.0f, 1e-6f);
}

TEST(Blurred, HiddenPixelsHideAllThatTheyBlur) {
  std::vector<uint8_t> mask(21 * 21, 255);
  mask[10 * 21 + 10] = 0;
  const internal::BlurredMask wide = internal::blurred_mask({mask.data(), 21, 21, 0, PixelFormat::r8}, {8, 0});
  for (int u = 0; u < 21; ++u) EXPECT_EQ(wide.pixels[10 * 21 + static_cast<size_t>(u)] == 0, std::abs(u - 10) <= 4) << u;
  EXPECT_TRUE(internal::blurred_mask({}, {8, 0}).view.empty());
}

class BlurredPair : public testing::Test {
 protected:
  static Cascade::Step step(const std::string& model) {
    Plan plan{320, 240};
    plan.max_features = 80;
    plan.max_references = plan.max_pairs = 3;
    plan.format = PixelFormat::r32f;
    AlignerOptions options;
    options.levels = 4;
    options.search = true;
    return {model, [plan, options] { return make_cpu_aligner(plan, options); }, RefinerOptions()};
  }
  static CascadePair pair(const Scene& s) { return {{s.image0.view(), s.relief.camera, s.features, {}}, s.image1.view(), {}}; }
};

TEST_F(BlurredPair, IsConfirmedByImagesThatAreBlurredAlike) {
  Scene scene, sharp;
  scene.blur({17, 6}, Vector2d::Zero());
  Cascade cascade({step("one")});
  const CascadePair pairs[] = {pair(scene), pair(sharp)};
  const auto results = cascade.align(pairs);
  ASSERT_TRUE(results[0].converged()) << results[0].reason;
  ASSERT_TRUE(results[0].blur) << results[0].reason;
  EXPECT_LT(apart(results[0].blur->reference, {17, 6}), 3);
  EXPECT_TRUE(results[0].refined);
  EXPECT_LT(test::pixel_error(scene.relief, scene.features, results[0].T_10), 0.5);
  EXPECT_TRUE(results[1].converged());
  EXPECT_FALSE(results[1].blur);
}

TEST_F(BlurredPair, KeyframesAreAsTheyWereAfterwards) {
  Scene scene;
  const Frame sharp0 = scene.image0, sharp1 = scene.image1;
  scene.blur(Vector2d::Zero(), {4, 16});
  Cascade cascade({step("first"), step("second")});
  cascade.set_reference(0, {sharp0.view(), scene.relief.camera, scene.features, {}});
  const Pair blurred{0, scene.image1.view()}, plain{0, sharp1.view()};
  const Pair one[] = {plain}, both[] = {blurred, plain};
  const auto before = cascade.align(one), together = cascade.align(both), after = cascade.align(one);
  EXPECT_TRUE(together[0].blur) << together[0].reason;
  EXPECT_EQ(together[0].model, "second");
  for (const auto& r : {together[1], after[0]}) {
    EXPECT_EQ(r.T_10.t, before[0].T_10.t);
    EXPECT_EQ(r.T_10.R, before[0].T_10.R);
  }
}

// Half of the aligned features agree, which is enough for a first look.
TEST_F(BlurredPair, WrongDepthsNeedMoreThanASecondLook) {
  Scene scene;
  Relief& relief = scene.relief;
  relief.depth_amplitude = 0.2;
  Vector6d xi;
  xi << 0.6, -0.18, 0.12, 0.01, 0.02, 0.03;
  relief.T_10 = SE3::exp(xi);
  scene.image0 = test::render(relief, 0);
  scene.image1 = test::render(relief, 1);
  scene.features = test::random_features(relief, 80);
  scene.blur({11, 6}, Vector2d::Zero());
  for (size_t i = 0; i < scene.features.uv.size(); ++i) {
    const Vector2d& uv = scene.features.uv[i];
    scene.features.inverse_depth[i] = 1 / relief.depth({319 - uv.x(), uv.y()});  // mirrored
  }
  Cascade::Step one = step("one");
  one.local_contrast = one.gradients = true;
  Cascade cascade({one});
  const CascadePair mirrored = pair(scene);
  const RefinedAlignment r = cascade.align(std::span(&mirrored, 1)).front();
  EXPECT_FALSE(r.converged()) << r.reason;
  EXPECT_TRUE(r.covariance.isZero(0)) << "no claim, no covariance";
}

}  // namespace
}  // namespace iclk
