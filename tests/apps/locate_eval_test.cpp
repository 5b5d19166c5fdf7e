// Maps that are degraded: what changes is what was asked for, and places stay.
#include <gtest/gtest.h>
#include <iclk/render/procedural.h>

#include "../support/device.h"
#include "apps/eval/locate/run.h"
#include "apps/iclk/sets/render_options.h"

namespace iclk {
namespace {

Terrain ground() { return procedural_terrain({.seed = 3, .size = 128, .relief = 20}); }

double mean_difference(const std::vector<float>& a, const std::vector<float>& b) {
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += std::abs(a[i] - b[i]);
  return sum / static_cast<double>(a.size());
}

TEST(MapDefects, NoneLeaveTheMapAsItIs) { EXPECT_EQ(degraded(ground(), {}).hash(), ground().hash()); }

TEST(MapDefects, OneSeedIsOneMap) {
  const MapDefects one = draw_defects(5, 0.2), other = draw_defects(6, 0.2);
  EXPECT_EQ(degraded(ground(), one).hash(), degraded(ground(), draw_defects(5, 0.2)).hash());
  EXPECT_NE(to_json(one), to_json(other));
}

TEST(MapDefects, CoarserGridsCoverTheSameGround) {
  MapDefects defects;
  defects.texel = 1, defects.spacing = 4;
  const Terrain map = degraded(ground(), defects);
  map.check();
  EXPECT_NEAR(map.mosaic.step_x, 1, 0.01);
  EXPECT_NEAR(map.relief.step_x, 4, 0.1);
  EXPECT_NEAR(map.extent().width(), ground().extent().width(), 4);
  double sum = 0;
  for (int i = 0; i < 100; ++i) {
    const double x = 20 + 8.0 * (i % 10), y = 20 + 8.0 * (i / 10);
    sum += map.height_at(x, y).value() - ground().height_at(x, y).value();
  }
  EXPECT_NEAR(sum / 100, 0, 0.5);
}

TEST(MapDefects, HeightsHaveTheNoiseThatWasAskedFor) {
  MapDefects defects;
  defects.height_noise = 0.4;
  const double off = mean_difference(degraded(ground(), defects).height, ground().height);
  EXPECT_GT(off, 0.15);
  EXPECT_LT(off, 0.4);
}

TEST(MapDefects, MissingHousesOnlyLowerTheGround) {
  MapDefects defects;
  defects.missing = 1;
  const Terrain map = degraded(ground(), defects), before = ground();
  EXPECT_GT(mean_difference(map.height, before.height), 0);
  for (size_t i = 0; i < map.height.size(); ++i) EXPECT_LE(map.height[i], before.height[i]);
}

TEST(MapDefects, ASeasonIsAnotherDay) {
  for (uint64_t seed = 0; seed < 50; ++seed) {
    const MapDefects one = draw_season(seed, 0.2);
    ASSERT_TRUE(one.dates);
    EXPECT_NE(one.dates->frames.season, one.dates->map.season);
    EXPECT_NE(one.dates->map.season, Season::snow);
    EXPECT_EQ(one.light, 0) << "the date has its own sun";
    for (const Date& date : {one.dates->frames, one.dates->map}) {
      const Date read = parse_date(to_text(date));
      EXPECT_EQ(std::tuple(read.season, read.year), std::tuple(date.season, date.year));
      EXPECT_EQ(std::tuple(read.sun_azimuth, read.sun_elevation), std::tuple(date.sun_azimuth, date.sun_elevation));
    }
  }
}

TEST(LocateEval, SeasonsAreOfProceduralGround) {
  LocateEvalOptions options;
  options.season = options.perfect = true;
  EXPECT_THROW(options.check(), Error);
  options.perfect = false;
  options.check();
  options.ortho = options.elevation = "map.tif";
  EXPECT_THROW(options.check(), Error);
}

// Light moves what woods look like, and a model's pose with them.
TEST(LocateEval, WoodsUnderAnotherSunAreNotClaimed) {
  ICLK_NEED_DEVICE();
  LocateEvalOptions options;
  options.locator.session.model_folders = {ICLK_SOURCE_DIR "/models"};  // of the tree: nothing is installed here
  options.frames = options.maps = 1;
  options.seed = 1601;
  options.season = true;
  options.metres = 10, options.degrees = 5;
  const LocateSample sample = run_locate_eval(options, {}).methods[0].samples[0];
  EXPECT_EQ(sample.located.status, Status::degenerate);
  EXPECT_NE(sample.located.reason.find("lit differently"), std::string::npos) << sample.located.reason;
  EXPECT_TRUE(sample.located.covariance.isZero());
}

}  // namespace
}  // namespace iclk
