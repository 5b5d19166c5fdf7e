#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include <iclk/track/internal/detector.h>

#include "relief.h"

namespace iclk::test {
namespace {

using namespace internal;

struct Seen {
  Relief scene;
  Frame image = render(scene, 0);
  std::vector<float> depth = std::vector<float>(160 * 120, 4.0f);
  std::vector<uint8_t> mask = {};
  Features detect(int count = 60) const {
    const ImageView hidden = mask.empty() ? ImageView() : ImageView{mask.data(), 160, 120, 0, PixelFormat::r8};
    return detect_corners(grey_map(image.view()), {depth.data(), 160, 120, 0, PixelFormat::r32f}, hidden, count, 16);
  }
};

TEST(Detector, FeaturesAreSpreadAndApart) {
  const Seen seen;
  const Features f = seen.detect();
  EXPECT_EQ(f.size(), 60);
  EXPECT_TRUE(f.inverse_depth_sigma.empty());
  int quarters[4] = {};
  for (size_t i = 0; i < f.uv.size(); ++i) {
    EXPECT_EQ(f.inverse_depth[i], 0.25);
    EXPECT_TRUE(f.uv[i].x() >= 16 && f.uv[i].x() < 144 && f.uv[i].y() >= 16 && f.uv[i].y() < 104);
    ++quarters[(f.uv[i].x() > 80) + 2 * (f.uv[i].y() > 60)];
    for (size_t j = 0; j < i; ++j) EXPECT_GE((f.uv[i] - f.uv[j]).lpNorm<Eigen::Infinity>(), 8);
  }
  for (const int n : quarters) EXPECT_GE(n, 10);
}

TEST(Detector, NoneWithoutDepthAndEdgesLast) {
  Seen seen;
  for (int v = 0; v < 120; ++v)
    for (int u = 0; u < 160; ++u) {
      float& z = seen.depth[static_cast<size_t>(160 * v + u)];
      const float none[] = {0, -1, std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()};
      if (u < 70) z = none[(u + v) % 4];
      if (u > 110) z = 3;  // a step
    }
  const Features f = seen.detect(25);
  EXPECT_EQ(f.size(), 25);
  for (const Eigen::Vector2d& uv : f.uv) EXPECT_TRUE(uv.x() >= 73 && (uv.x() <= 106 || uv.x() >= 114)) << uv.x();
}

TEST(Detector, DepthBesideCornersServesIfItIsSparse) {
  Seen seen;
  for (int v = 0; v < 120; ++v)
    for (int u = 0; u < 160; ++u)
      if (v % 12 != 6 || u % 3 != 0) seen.depth[static_cast<size_t>(160 * v + u)] = 0;
  seen.depth[160 * 54 + 81] = 2;  // an edge among known depths
  const Features f = seen.detect(40);
  EXPECT_EQ(f.size(), 40);
  for (size_t i = 0; i < f.uv.size(); ++i) {
    EXPECT_TRUE(static_cast<int>(f.uv[i].y()) % 12 == 6 && static_cast<int>(f.uv[i].x()) % 3 == 0) << f.uv[i].transpose();
    EXPECT_EQ(f.inverse_depth[i], 0.25);
  }
}

TEST(Detector, NoPatchReachesIntoWhatIsHidden) {
  Seen seen;
  seen.mask.assign(160 * 120, 255);
  std::fill(seen.mask.begin() + 160 * 70, seen.mask.end(), uint8_t{0});
  const Features f = seen.detect();
  EXPECT_GE(f.size(), 20);
  for (const Eigen::Vector2d& uv : f.uv) EXPECT_LT(uv.y() + 4, 70);  // a patch reaches four rows down
}

TEST(Detector, FlatImagesAndBadOnesHaveNone) {
  Seen seen;
  std::fill(seen.image.data.begin(), seen.image.data.end(), 0.5f);
  EXPECT_EQ(seen.detect().size(), 0);
  std::fill(seen.image.data.begin(), seen.image.data.end(), std::numeric_limits<float>::quiet_NaN());
  EXPECT_EQ(seen.detect().size(), 0);
  const std::vector<float> tiny(100, 1.0f);
  EXPECT_EQ(detect_corners(Map(10, 10), {tiny.data(), 10, 10, 0, PixelFormat::r32f}, {}, 200, 16).size(), 0);
}

}  // namespace
}  // namespace iclk::test
