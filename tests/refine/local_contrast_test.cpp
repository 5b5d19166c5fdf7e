// Images whose light differs: local contrast leaves slow changes out, and pairs are aligned by it.
#include <cmath>
#include <limits>

#include <gtest/gtest.h>
#include <iclk/align/aligner.h>
#include <iclk/refine/cascade.h>
#include <iclk/refine/internal/local_contrast.h>

#include "../support/relief.h"

namespace iclk {
namespace {

using internal::FloatImage;
using internal::local_contrast;
using test::Frame;
using test::Relief;

Relief relief() {
  Relief r;
  r.camera = {300, 300, 159.5, 119.5, 320, 240};
  r.shortest = 4;
  r.longest = 60;
  r.waves = 120;
  r.contrast = 0.02;
  Vector6d xi;
  xi << 0.05, -0.03, 0.02, 0.01, 0.02, 0.03;
  r.T_10 = SE3::exp(xi);
  return r;
}

/// Haze: thick here and thin there.
Frame hazy(Frame frame, double phase) {
  for (int v = 0; v < frame.height; ++v)
    for (int u = 0; u < frame.width; ++u) {
      const double clear = std::exp(-1.2 * (1 + std::sin(2 * M_PI * (1.3 * u / frame.width + 0.8 * v / frame.height + phase))));
      frame.at(u, v) = static_cast<float>(frame.at(u, v) * clear + 0.85 * (1 - clear));
    }
  return frame;
}

double largest_difference(const FloatImage& a, const FloatImage& b, int border) {
  double most = 0;
  for (int v = border; v < a.view.height - border; ++v)
    for (int u = border; u < a.view.width - border; ++u) {
      const auto at = static_cast<size_t>(v) * static_cast<size_t>(a.view.width) + static_cast<size_t>(u);
      most = std::max(most, std::abs(static_cast<double>(a.pixels[at]) - b.pixels[at]));
    }
  return most;
}

TEST(LocalContrast, GainAndBiasMakeLittleDifference) {
  const Frame frame = test::render(relief(), 0);
  Frame brighter = frame;
  for (float& x : brighter.data) x = 0.7f * x + 0.2f;
  const FloatImage before = local_contrast(frame.view()), after = local_contrast(brighter.view());
  EXPECT_LT(largest_difference(before, after, 0), 0.06);
  double mean = 0;
  for (const float x : before.pixels) mean += x / static_cast<double>(before.pixels.size());
  EXPECT_NEAR(mean, 0.5, 0.02);
}

TEST(LocalContrast, HiddenPixelsDoNotCount) {
  const Frame frame = test::render(relief(), 0);
  Frame black = frame;
  std::vector<uint8_t> mask(frame.data.size(), 255);
  for (int v = 0; v < frame.height; ++v)
    for (int u = 0; u < frame.width / 2; ++u)
      black.at(u, v) = -3, mask[static_cast<size_t>(v) * 320 + static_cast<size_t>(u)] = 0;
  const ImageView hides{mask.data(), 320, 240, 0, PixelFormat::r8};
  const FloatImage with_mask = local_contrast(black.view(), hides), without = local_contrast(black.view()),
                   same = local_contrast(frame.view(), hides);
  const size_t beside = 120 * 320 + 162;  // two pixels from what is hidden
  EXPECT_FLOAT_EQ(with_mask.pixels[beside], same.pixels[beside]);
  EXPECT_GT(std::abs(without.pixels[beside] - same.pixels[beside]), 0.05);
}

TEST(LocalContrast, BadPixelsStayWhereTheyAre) {
  const float nan = std::numeric_limits<float>::quiet_NaN(), infinite = std::numeric_limits<float>::infinity();
  Frame frame = test::render(relief(), 0);
  const FloatImage before = local_contrast(frame.view());
  frame.at(100, 100) = nan;
  frame.at(200, 50) = infinite;
  frame.at(10, 10) = 1e30f;
  const FloatImage image = local_contrast(frame.view());
  int bad = 0;
  for (const float x : image.pixels) bad += !(x >= 0 && x <= 1);
  EXPECT_EQ(bad, 2) << "a value that is finite is clamped";
  EXPECT_TRUE(std::isnan(image.pixels[100 * 320 + 100]));
  EXPECT_NEAR(image.pixels[101 * 320 + 100], before.pixels[101 * 320 + 100], 0.01);
  const Frame flat{8, 8, std::vector<float>(64, 0.3f)};
  for (const float x : local_contrast(flat.view()).pixels) EXPECT_NEAR(x, 0.5f, 1e-4f);
}

TEST(LocalContrast, PairsInHazeAreAligned) {
  const Relief r = relief();
  const Frame image0 = hazy(test::render(r, 0), 0), image1 = hazy(test::render(r, 1), 0.5), sharp1 = test::render(r, 1);
  const Features features = test::random_features(r, 80);
  Plan plan{320, 240};
  plan.max_features = 80;
  plan.max_references = plan.max_pairs = 2;
  plan.format = PixelFormat::r32f;
  AlignerOptions options;
  options.search = true;
  const auto make = [&] { return make_cpu_aligner(plan, options); };
  const CascadePair pair{{image0.view(), r.camera, features, {}}, image1.view(), {}};
  Cascade plain({{"classical", make, RefinerOptions()}}), second({{"classical", make, RefinerOptions(), true}});
  const RefinedAlignment without = plain.align(std::span(&pair, 1)).front(), with = second.align(std::span(&pair, 1)).front();
  EXPECT_FALSE(without.converged()) << "or this test shows nothing";
  ASSERT_TRUE(with.converged()) << with.reason;
  EXPECT_LT(test::pixel_error(r, features, with.T_10), 0.3);
  ASSERT_EQ(with.attempts.size(), 2u);
  EXPECT_EQ(with.attempts[1].model, "classical, local contrast");
  EXPECT_EQ(with.model, "classical");

  // What converges is not aligned again, and the pixels of keyframes are theirs again.
  second.set_reference(0, pair.reference);
  const Pair changed{0, image1.view()};
  EXPECT_TRUE(second.align(std::span(&changed, 1)).front().converged());
  EXPECT_EQ(second.reference(0)->image.format, PixelFormat::r32f);
  EXPECT_EQ(static_cast<const float*>(second.reference(0)->image.data)[5], image0.data[5]);
  second.set_reference(1, {sharp1.view(), r.camera, features, {}});
  const Pair itself{1, sharp1.view()};
  EXPECT_EQ(second.align(std::span(&itself, 1)).front().attempts.size(), 1u);
}

}  // namespace
}  // namespace iclk
