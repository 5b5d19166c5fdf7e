// What another pose explains as well is no claim: walls of tiles, captions, own vehicles, things that move by themselves.
#include <algorithm>

#include <gtest/gtest.h>
#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/refine/cascade.h>
#include <iclk/refine/internal/rivals.h>

#include "rival_scenes.h"

namespace iclk {
namespace {

using test::Frame;
using namespace test::rivals;

RefinedAlignment align(const Frame& image0, const Frame& image1, const SE3& near = {}) {
  AlignerOptions options;
  options.search = true;
  Plan plan{kCamera.width, kCamera.height};
  plan.max_features = 300;
  plan.format = PixelFormat::r32f;
  Cascade cascade({{"classical", [&] { return make_cpu_aligner(plan, options); }, RefinerOptions()}});
  CascadePair pair{{image0.view(), kCamera, lattice(kDistance), {}}, image1.view(), {}};
  pair.T_10 = near;
  return cascade.align(std::span(&pair, 1)).front();
}

TEST(Rivals, AWallOfTilesIsAmbiguous) {
  const Waves tile(kPeriod, 3), own(0, 4);
  const auto wall = [&](double x, double y) { return 0.5 + 0.05 * tile(x, y) + 0.003 * own(x, y); };
  for (const double shift : {0.3, 0.6, 0.8}) {
    const SE3 truth = sideways(shift * kPeriod, 0.1);
    // Where matching finds no start, it begins a tile beside the truth.
    const SE3 beside = sideways((shift - 1) * kPeriod, 0.1);
    const RefinedAlignment r = align(render(wall, SE3(), 1), render(wall, truth, 2), beside);
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

// The object explains so many features that the search for rivals stops early.
TEST(Rivals, NoMotionRivalsAStartThatWasFound) {
  const Waves scene(0, 6), thing(0, 8);
  const auto wall = [&](double x, double y) { return 0.5 + 0.015 * scene(x, y); };
  const auto moving = [&](double x, double y) { return 0.5 + 0.05 * thing(x, y); };
  const auto at_rest = [&](const SE3& T_thing, uint32_t seed) {
    Frame image = render(wall, SE3(), seed);
    const Frame front = render(moving, T_thing, seed + 10),
                mask =
                    render([](double x, double y) { return std::abs(x) < 1.7 && std::abs(y) < 1.275 ? 1.0 : 0.0; }, T_thing, 0);
    for (size_t i = 0; i < image.data.size(); ++i)
      if (mask.data[i] > 0.5f) image.data[i] = front.data[i];
    return image;
  };
  AlignerOptions options;
  options.search = true;
  Plan plan{kCamera.width, kCamera.height};
  plan.max_features = 300;
  plan.format = PixelFormat::r32f;
  const auto aligner = make_cpu_aligner(plan, options);
  Refiner refiner(*aligner);
  const Frame image0 = at_rest(SE3(), 1);
  aligner->set_reference(0, {image0.view(), kCamera, lattice(kDistance), {}});
  for (const double shift : {0.2, 0.25, 0.3, 0.35}) {
    const SE3 passes = sideways(shift, 0.1);
    const Frame image1 = at_rest(passes, 2);
    Pair pair{0, image1.view(), passes};
    pair.found = true;
    const RefinedAlignment r = refiner.align(pair);
    EXPECT_EQ(r.status, Status::ambiguous) << shift << " m: " << r.reason;
    ASSERT_FALSE(r.rivals.empty()) << shift << " m";
    EXPECT_LT(error(r.rivals.front().T_10, SE3()), 1) << shift << " m";
  }
}

/// A pose on which some of the features agree, and nothing is found of the others.
RefinedAlignment claim(const Features& features, const SE3& T_10, const std::vector<bool>& agree) {
  RefinedAlignment r;
  r.T_10 = T_10;
  r.status = Status::converged;
  r.refined = true;
  r.stages.push_back({"iclk", T_10, 0, 0});
  r.inliers = static_cast<int>(std::count(agree.begin(), agree.end(), true));
  r.features.resize(agree.size());
  for (size_t i = 0; i < agree.size(); ++i) {
    r.features[i].status = agree[i] ? FeatureStatus::aligned : FeatureStatus::bad_match;
    if (agree[i]) r.features[i].uv1 = kCamera.project(T_10 * (kCamera.ray(features.uv[i]) / features.inverse_depth[i]));
  }
  return r;
}

TEST(Rivals, TheSceneSurroundsWhatMovesInIt) {
  const SE3 scene = sideways(0.2, 0.05), other = sideways(-0.25, -0.15);
  for (const bool together : {true, false}) {  // the features of the rival: on a thing, or all over the view
    Features features = lattice(kDistance);
    std::vector<bool> is_scene(features.uv.size(), true);
    std::mt19937 random(1);
    for (size_t i = 0, spread = is_scene.size() / 2; i < spread; ++i) {
      const Eigen::Vector2d at(random() % 1000 / 1000.0, random() % 1000 / 1000.0);
      const Eigen::Vector2d uv = together ? Eigen::Vector2d(130 + 60 * at.x(), 90 + 60 * at.y())
                                          : Eigen::Vector2d(16 + 288 * at.x(), 16 + 208 * at.y());
      features.uv.push_back(uv);
      features.inverse_depth.push_back(1 / kDistance);
      is_scene.push_back(false);
    }
    std::vector<bool> is_other = is_scene;
    is_other.flip();
    const std::vector<FeatureCheck> checks(features.uv.size(), FeatureCheck::ok);
    RefinedAlignment answer = claim(features, scene, is_scene);
    std::vector<RefinedAlignment> rivals = {claim(features, other, is_other)};
    internal::weigh({kCamera, features, checks}, RefinerOptions(), rivals, answer);
    EXPECT_EQ(answer.status, together ? Status::converged : Status::ambiguous) << answer.reason;
    EXPECT_EQ(answer.rivals.size(), together ? 0u : 1u);
    EXPECT_EQ(answer.T_10.matrix(), scene.matrix());
  }
}

}  // namespace
}  // namespace iclk
