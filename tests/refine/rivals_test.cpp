// What another pose explains as well is no claim: walls of tiles, captions, own vehicles, things that move by themselves.
#include <gtest/gtest.h>
#include <iclk/align/cpu_aligner.h>
#include <iclk/refine/cascade.h>

#include "rival_scenes.h"

namespace iclk {
namespace {

using test::Frame;
using namespace test::rivals;

RefinedAlignment align(const Frame& image0, const Frame& image1) {
  AlignerOptions options;
  options.search.enabled = true;
  Plan plan{kCamera.width, kCamera.height};
  plan.max_features = 300;
  plan.format = PixelFormat::r32f;
  Cascade cascade({{"classical", [&] { return make_cpu_aligner(plan, options); }, RefinerOptions()}});
  const CascadePair pair{{image0.view(), kCamera, lattice(kDistance), {}}, image1.view(), {}};
  return cascade.align(std::span(&pair, 1)).front();
}

TEST(Rivals, AWallOfTilesIsAmbiguous) {
  const Waves tile(kPeriod, 3), own(0, 4);
  const auto wall = [&](double x, double y) { return 0.5 + 0.05 * tile(x, y) + 0.003 * own(x, y); };
  for (const double shift : {0.3, 0.6, 0.8}) {
    const SE3 truth = sideways(shift * kPeriod, 0.1);
    const RefinedAlignment r = align(render(wall, SE3(), 1), render(wall, truth, 2));
    if (r.converged()) {
      EXPECT_LT(error(r.T_10, truth), 1) << shift << " periods: " << r.reason;
      continue;
    }
    EXPECT_TRUE(r.status == Status::ambiguous || r.status == Status::degenerate) << r.reason;
    EXPECT_TRUE(r.covariance.isZero(0));
    if (r.status != Status::ambiguous) continue;
    EXPECT_FALSE(r.rivals.empty());
    for (size_t i = 1; i < r.rivals.size(); ++i) EXPECT_GE(r.rivals[i - 1].inliers, r.rivals[i].inliers);
  }
}

TEST(Rivals, AMarkOnTheWallDecides) {
  const Waves tile(kPeriod, 3), own(0, 4), poster(0, 5);
  const auto wall = [&](double x, double y) {
    const bool inside = std::abs(x - 0.1) < 0.7 && std::abs(y) < 0.55;
    return 0.5 + (inside ? 0.05 * poster(x, y) : 0.05 * tile(x, y) + 0.015 * own(x, y));
  };
  for (const double shift : {0.6, 0.8, 1.1}) {
    const SE3 truth = sideways(shift * kPeriod, 0.1);
    const RefinedAlignment r = align(render(wall, SE3(), 1), render(wall, truth, 2));
    EXPECT_TRUE(r.converged()) << shift << " periods: " << name(r.status) << ": " << r.reason;
    EXPECT_LT(error(r.T_10, truth), 0.5) << shift << " periods";
    EXPECT_TRUE(r.rivals.empty());
  }
}

TEST(Rivals, WhatIsFixedToTheCameraIsLeftOutOrDoubted) {
  const Waves scene(0, 6), vehicle(0, 7);
  const auto wall = [&](double x, double y) { return 0.5 + 0.015 * scene(x, y); };
  const Frame fixed = render([&](double x, double y) { return 0.5 + 0.05 * vehicle(x, y); }, SE3(), 3);
  const SE3 truth = sideways(0.25, 0.1);
  for (const int first : {140, 120, 100}) {  // the lower 42, 50, 58 %
    Frame image0 = render(wall, SE3(), 1), image1 = render(wall, truth, 2);
    overlay(image0, fixed, first, 240);
    overlay(image1, fixed, first, 240);
    const RefinedAlignment r = align(image0, image1);
    if (r.converged()) {
      EXPECT_LT(error(r.T_10, truth), 1) << "from row " << first << ": " << r.reason;
    }
  }
}

TEST(Rivals, ACameraThatStandsStillMaySaySo) {
  const Waves scene(0, 6);
  const auto wall = [&](double x, double y) { return 0.5 + 0.05 * scene(x, y); };
  const RefinedAlignment r = align(render(wall, SE3(), 1), render(wall, SE3(), 2));
  EXPECT_TRUE(r.converged()) << r.reason;
  EXPECT_TRUE(r.fixed.empty());
}

TEST(Rivals, WhatMovesByItselfIsNotTheScene) {
  const Waves scene(0, 6), thing(0, 8);
  const SE3 truth = sideways(0.2, 0.05), other = sideways(-0.25, -0.15);
  const auto wall = [&](double x, double y) { return 0.5 + 0.015 * scene(x, y); };
  const auto moving = [&](double x, double y) { return 0.5 + 0.05 * thing(x, y); };
  for (const double half : {0.8, 1.1}) {  // m: 18 and 34 % of the view
    const auto both = [&](const SE3& T_scene, const SE3& T_thing, uint32_t seed) {
      Frame image = render(wall, T_scene, seed);
      const Frame front = render(moving, T_thing, seed + 10),
                  mask = render([&](double x, double y) { return std::abs(x) < 1.3 * half && std::abs(y) < half ? 1.0 : 0.0; },
                                T_thing, 0);
      for (size_t i = 0; i < image.data.size(); ++i)
        if (mask.data[i] > 0.5f) image.data[i] = front.data[i];
      return image;
    };
    const RefinedAlignment r = align(both(SE3(), SE3(), 1), both(truth, other, 2));
    if (r.converged()) {
      EXPECT_LT(error(r.T_10, truth), 1) << half << " m: " << r.reason;
    }
  }
}

}  // namespace
}  // namespace iclk
