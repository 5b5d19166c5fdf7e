// One place on two dates: the ground stays, colours and shadows do not.
#include <gtest/gtest.h>

#include <iclk/render/internal/shadows.h>
#include <iclk/render/pairs.h>
#include <iclk/render/procedural.h>

#include "device.h"
#include "files.h"
#include "render_fixture.h"

namespace iclk {
namespace {

using test::expect_error;

constexpr Season kSeasons[] = {Season::spring, Season::summer, Season::autumn, Season::winter, Season::snow};

Terrain at(const std::optional<Date>& date, double size = 80, int threads = 0) {
  return procedural_terrain({.seed = 4, .size = size, .mosaic_step = 0.5, .date = date, .threads = threads});
}

/// The share of texels whose colour differs by more than a few grey values.
double changed(const Terrain& a, const Terrain& b) {
  size_t count = 0;
  for (size_t i = 0; i < a.rgba.size(); ++i)
    for (int c = 0; c < 24; c += 8)
      if (std::abs(static_cast<int>(a.rgba[i] >> c & 255) - static_cast<int>(b.rgba[i] >> c & 255)) > 8) {
        ++count;
        break;
      }
  return static_cast<double>(count) / static_cast<double>(a.rgba.size());
}

TEST(Dates, KeepTheGroundAndChangeItsColours) {
  const Terrain plain = at(std::nullopt);
  for (const Season season : kSeasons) {
    const Terrain now = at(Date::of(season)), later = at(Date::of(season, 1));
    EXPECT_EQ(now.height, plain.height);
    EXPECT_GT(changed(now, plain), 0.3);
    EXPECT_GT(changed(now, later), 0.05) << "crops and growth are another year's";
    EXPECT_EQ(now.hash(), at(Date::of(season), 80, 1).hash()) << "any number of threads";
    for (const Season other : kSeasons) {
      if (other == season) continue;
      EXPECT_GT(changed(now, at(Date::of(other))), 0.3);
    }
  }
}

TEST(Dates, TheSunCastsShadows) {
  // A wall of 10 m, 2 m thick, on level ground; the sun stands in the west, 45 degrees high.
  Terrain terrain;
  terrain.relief = {80, 80, 0, 80, 1, 1};
  terrain.height.assign(6400, 0);
  for (size_t row = 0; row < 80; ++row)
    for (size_t column : {40, 41}) terrain.height[row * 80 + column] = 10;
  Date date;
  date.sun_azimuth = 1.5 * M_PI, date.sun_elevation = M_PI / 4;
  EXPECT_LT((date.to_sun() - Eigen::Vector3d(-1, 0, 1).normalized()).norm(), 1e-12);
  const internal::Shadows shadows(terrain, date.to_sun(), 1);
  for (const double x : {10.0, 35.0, 53.5, 70.0}) EXPECT_EQ(shadows.sunlit(x, 40.5), 1) << x;
  for (const double x : {44.0, 50.5}) EXPECT_EQ(shadows.sunlit(x, 40.5), 0) << x;
  date.sun_elevation = M_PI / 8;
  const internal::Shadows longer(terrain, date.to_sun(), 1);
  EXPECT_EQ(longer.sunlit(53.5, 40.5), 0);
  EXPECT_EQ(longer.sunlit(70, 40.5), 1);
}

TEST(Dates, ASunBelowTheHorizonIsRefused) {
  for (const double elevation : {-0.1, 0.0, 2.0, static_cast<double>(NAN)}) {
    Date date;
    date.sun_elevation = elevation;
    expect_error([&] { at(date); }, ErrorCode::invalid_argument, {"elevation", "5 to 90"});
  }
}

TEST(Dates, ThePairIsThatOfOneDateInOtherColours) {
  ICLK_NEED_DEVICE();
  const auto renderer = [](Season season) {
    return TerrainRenderer(test::device(), std::make_shared<Terrain>(at(Date::of(season), 300)), {.samples = 1});
  };
  TerrainRenderer summer = renderer(Season::summer), winter = renderer(Season::winter);
  PairOptions options;
  options.camera = {100, 100, 46.5, 29.5, 94, 60};
  const RenderedPair one = PairSource(summer, options).draw(0), two = PairSource(summer, options, &winter).draw(0);
  EXPECT_EQ(one.T_10.matrix(), two.T_10.matrix());
  EXPECT_EQ(one.view0.rgba, two.view0.rgba);
  EXPECT_EQ(one.view1.depth, two.view1.depth);
  EXPECT_NE(one.view1.rgba, two.view1.rgba);
  EXPECT_EQ(two.view1.rgba, winter.render(options.camera, two.T_W1).rgba);
}

}  // namespace
}  // namespace iclk
