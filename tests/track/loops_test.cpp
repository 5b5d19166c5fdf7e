// Places seen again: loops that exist, and loops that only seem to.
#include <cstdlib>

#include "small_flight.h"

namespace iclk::test {
namespace {

TEST(Loops, AFigureOfEightIsClosed) {
  ICLK_NEED_DEVICE();
  const auto terrain = std::make_shared<const Terrain>(procedural_terrain({.seed = 3, .size = 256}));
  std::vector<Shot> shots;
  for (int i = 0; i < 70; ++i) {
    const double a = 2 * M_PI * i / 64;
    shots.push_back({looking_down(128 + 65 * std::sin(a), 128 + 65 * std::sin(a) * std::cos(a))});
  }
  TrackerOptions options = small_options();
  const Flown closed = fly(terrain, shots, options);
  options.archive = 0;
  const Flown open = fly(terrain, shots, options);
  EXPECT_EQ(closed.lost, 0);
  EXPECT_GE(closed.loops, 2u);
  EXPECT_EQ(open.loops, 0u);
  EXPECT_LT(closed.worst, 0.7 * open.worst);
}

/// The same 160 m of ground again and again; a view shows 103 m of it.
Terrain repeated_ground(uint32_t seed) {
  Terrain terrain = procedural_terrain({.seed = seed, .size = 512});
  const auto repeat = [](auto& values, const Grid& grid) {
    const int period = static_cast<int>(std::lround(160 / grid.step_y));
    for (int v = period; v < grid.height; ++v)
      std::copy_n(values.begin() + static_cast<std::ptrdiff_t>(v - period) * grid.width, grid.width,
                  values.begin() + static_cast<std::ptrdiff_t>(v) * grid.width);
  };
  repeat(terrain.height, terrain.relief);
  repeat(terrain.rgba, terrain.mosaic);
  return terrain;
}

Flown fly_over_copies(uint32_t seed, const std::vector<double>& ys) {
  std::vector<Shot> shots;
  for (const double y : ys) shots.push_back({looking_down(256, y)});
  return fly(std::make_shared<const Terrain>(repeated_ground(seed)), shots, small_options());
}

std::vector<double> steps(double from, double step, int count) {
  std::vector<double> ys;
  for (int i = 0; i < count; ++i) ys.push_back(from + step * i);
  return ys;
}

/// ICLK_LONG_FRAMES=10000 flies over more grounds.
TEST(Loops, RepeatedGroundIsNoLoop) {
  ICLK_NEED_DEVICE();
  const Flown flown = fly_over_copies(5, steps(80, 6, 60));
  EXPECT_EQ(flown.lost, 0);
  EXPECT_EQ(flown.maps, 1);
  EXPECT_EQ(flown.loops, 0u);
  EXPECT_LT(flown.worst, 10);
  const char* const frames = std::getenv("ICLK_LONG_FRAMES");
  const uint32_t grounds = frames ? static_cast<uint32_t>(std::atoi(frames)) / 60 : 1;
  for (uint32_t i = 1; i < grounds; ++i) EXPECT_EQ(fly_over_copies(5 + i, steps(80, 6, 60)).loops, 0u) << 5 + i;
}

/// The second map of this flight sees a copy of what the first one saw, and the third one, too.
TEST(Loops, MapsAreNotJoinedByACopy) {
  ICLK_NEED_DEVICE();
  const Flown flown = fly_over_copies(13, steps(80, 6, 60));
  EXPECT_GT(flown.maps, 1) << "the flight tests nothing";
  EXPECT_EQ(flown.loops, 0u);
  EXPECT_LT(flown.worst, 20);
}

TEST(Loops, ALostCameraIsNotFoundInACopy) {
  ICLK_NEED_DEVICE();
  std::vector<double> ys = steps(80, 3, 34);
  for (const double y : steps(243, 3, 5)) ys.push_back(y);  // a copy of 83 m, out of reach
  const Flown flown = fly_over_copies(5, ys);
  EXPECT_GT(flown.lost, 0) << "the flight tests nothing";
  EXPECT_LT(flown.worst, 10);
}

}  // namespace
}  // namespace iclk::test
