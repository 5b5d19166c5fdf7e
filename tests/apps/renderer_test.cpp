// Views of surfaces whose depth and colour are known.
#include <random>

#include <gtest/gtest.h>

#include <iclk/engine/compute/recorder.h>
#include <iclk/engine/submission.h>
#include <iclk/render/procedural.h>

#include "device.h"
#include "files.h"
#include "render_fixture.h"

namespace iclk {
namespace {

using test::expect_error;
using test::looking_down;
using test::make_terrain;
using test::rgb;

// Swiss national coordinates: single precision resolves 12 cm there.
constexpr double kEast = 2600123.4, kNorth = 1200456.7;
const Camera kCamera{180, 178, 95.3, 59.1, 192, 120};

View render(const Terrain& terrain, const Camera& camera, const SE3& T_WC, const RenderOptions& options = {}) {
  TerrainRenderer renderer(test::device(), std::make_shared<Terrain>(terrain), options);
  return renderer.render(camera, T_WC);
}

Grid square(double centre_x, double centre_y, int pixels, double step) {
  return {pixels, pixels, centre_x - 0.5 * pixels * step, centre_y + 0.5 * pixels * step, step, step};
}

std::vector<SE3> poses(const Eigen::Vector3d& over) {
  return {looking_down(over), looking_down(over + Eigen::Vector3d(3.3, -7.1, 5), 2.1, 0.35),
          looking_down(over + Eigen::Vector3d(-2, 4, -8), -0.7, -0.2, 1.0)};
}

TEST(Renderer, DepthAndColourOfAPlane) {
  ICLK_NEED_DEVICE();
  const auto plane = [](double x, double y) { return 420 + 0.25 * (x - kEast) - 0.15 * (y - kNorth); };
  // Waves of 12 m and 9 m: the phase of what is seen tells where it is seen to a hundredth of a pixel.
  const auto wave = [](double x, double y) {
    return Eigen::Vector2d(128 + 80 * std::sin(2 * M_PI * (x - kEast) / 12), 128 + 80 * std::sin(2 * M_PI * (y - kNorth) / 9));
  };
  const Terrain terrain = make_terrain(square(kEast + 1, kNorth - 2, 150, 1.7), square(kEast - 3, kNorth + 1, 800, 0.25), plane,
                                       [&](double x, double y) { return rgb(wave(x, y).x(), wave(x, y).y(), 77); });
  for (const SE3& T_WC : poses({kEast, kNorth, 500})) {
    const View view = render(terrain, kCamera, T_WC);
    double numerator[2] = {}, denominator[2] = {};
    for (int v = 0; v < view.height; ++v)
      for (int u = 0; u < view.width; ++u) {
        const Eigen::Vector3d d = T_WC.R * kCamera.ray({u, v});
        const double z = (plane(T_WC.t.x(), T_WC.t.y()) - T_WC.t.z()) / (d.z() - 0.25 * d.x() + 0.15 * d.y());
        const size_t at = static_cast<size_t>(v * view.width + u);
        ASSERT_NEAR(view.depth[at], z, 1e-5 * z) << u << ", " << v;
        const Eigen::Vector3d X = T_WC.t + z * d;
        const Eigen::Vector2d expected = wave(X.x(), X.y());
        const double seen[2] = {static_cast<double>(test::red(view.rgba[at])), static_cast<double>(test::green(view.rgba[at]))};
        EXPECT_NEAR(test::blue(view.rgba[at]), 77, 1);
        const double slope[2] = {std::cos(2 * M_PI * (X.x() - kEast) / 12), std::cos(2 * M_PI * (X.y() - kNorth) / 9)};
        const double metres[2] = {12 / (160 * M_PI), 9 / (160 * M_PI)};
        for (int i = 0; i < 2; ++i) {
          ASSERT_NEAR(seen[i], expected[i], 4) << "channel " << i << " at " << u << ", " << v;
          numerator[i] += metres[i] * slope[i] * (seen[i] - expected[i]);
          denominator[i] += slope[i] * slope[i];
        }
      }
    // A pixel is about 0.45 m on the ground.
    for (int i = 0; i < 2; ++i) EXPECT_LT(std::abs(numerator[i] / denominator[i]), 0.01 * 0.45) << "shifted on the map";
  }
}

TEST(Renderer, DepthOfASphere) {
  ICLK_NEED_DEVICE();
  constexpr double R = 300;
  const auto sphere = [](double x, double y) {
    return std::sqrt(std::max(R * R - std::pow(x - kEast, 2) - std::pow(y - kNorth, 2), 0.0));
  };
  const Terrain terrain = make_terrain(square(kEast, kNorth, 1000, 0.5), square(kEast, kNorth, 64, 8), sphere,
                                       [](double, double) { return rgb(100, 150, 200); });
  for (const SE3& T_WC : poses({kEast, kNorth, 520})) {
    const View view = render(terrain, kCamera, T_WC);
    int compared = 0;
    for (int v = 0; v < view.height; ++v)
      for (int u = 0; u < view.width; ++u) {
        const Eigen::Vector3d d = T_WC.R * kCamera.ray({u, v}), o = T_WC.t - Eigen::Vector3d(kEast, kNorth, 0);
        const double a = d.squaredNorm(), b = o.dot(d), c = o.squaredNorm() - R * R, disc = b * b - a * c;
        if (disc < 0) continue;
        const double z = (-b - std::sqrt(disc)) / a;
        if ((o + z * d).head<2>().norm() > 200) continue;  // steeper, the grid's chords leave the sphere
        ++compared;
        ASSERT_NEAR(view.depth[static_cast<size_t>(v * view.width + u)], z, 2e-5 * z) << u << ", " << v;
      }
    EXPECT_GT(compared, 10000);
  }
}

// From far away, a pattern finer than a pixel is its mean; seen along the ground, lines that run away from the camera stay
// apart, though a pixel's footprint is six times as long as wide there.
TEST(Renderer, FiltersAlongAndAcross) {
  ICLK_NEED_DEVICE();
  const auto flat = [](double, double) { return 0.0; };
  const Terrain checks = make_terrain(square(0, 0, 40, 10), square(0, 0, 1600, 0.25), flat, [](double x, double y) {
    return (static_cast<int>(std::floor(x * 4)) + static_cast<int>(std::floor(y * 4))) % 2 == 0 ? rgb(0, 0, 0)
                                                                                                : rgb(255, 255, 255);
  });
  for (const SE3& T_WC : {looking_down({0, 0, 200}), looking_down({0, -100, 120}, 0, 0.7)}) {
    const View view = render(checks, kCamera, T_WC, {.samples = 1});
    for (size_t i = 0; i < view.rgba.size(); ++i) {
      const bool seen = view.depth[i] > 0;
      ASSERT_NEAR(seen ? test::red(view.rgba[i]) : 127.5, 127.5, 5) << i;
    }
  }
  const Terrain lines = make_terrain(square(0, 0, 40, 10), square(0, 0, 1600, 0.25), flat,
                                     [](double x, double) { return rgb(128 + 100 * std::sin(2 * M_PI * x / 3), 0, 0); });
  // 80 degrees from straight down; at 100 m a pixel is 0.5 m wide and 3.2 m long.
  const SE3 T_WC = looking_down({0, -100, 100 * std::cos(1.4)}, 0, 1.4);
  const View view = render(lines, {200, 200, 95.5, 59.5, 192, 120}, T_WC, {.samples = 1});
  int least = 255, greatest = 0;
  for (int u = 40; u < 150; ++u) {
    const int value = test::red(view.rgba[static_cast<size_t>(60 * 192 + u)]);
    least = std::min(least, value), greatest = std::max(greatest, value);
  }
  EXPECT_GT(greatest - least, 120) << "of 200";
  // A slope that faces the camera: its lines are as sharp as from straight above.
  const Terrain slope = make_terrain(
      square(0, 0, 40, 10), square(0, 0, 1600, 0.25), [](double, double y) { return y; },
      [](double, double y) { return rgb(128 + 100 * std::sin(2 * M_PI * y / 3), 0, 0); });
  const View facing = render(slope, {200, 200, 95.5, 59.5, 192, 120}, looking_down({0, -70, 70}, 0, M_PI / 4), {.samples = 1});
  least = 255, greatest = 0;
  for (int v = 40; v < 80; ++v) {
    const int value = test::red(facing.rgba[static_cast<size_t>(v * 192 + 96)]);
    least = std::min(least, value), greatest = std::max(greatest, value);
  }
  EXPECT_GT(greatest - least, 170) << "of 200";
}

// Four coloured quarters: which way is up and left, of the map and of the image.
TEST(Renderer, AxesOfMapAndImage) {
  ICLK_NEED_DEVICE();
  const Terrain terrain = make_terrain(
      square(50, 50, 100, 1), square(50, 50, 200, 0.5), [](double, double) { return 10.0; },
      [](double x, double y) {
        return x < 50 ? y < 50 ? rgb(255, 0, 0) : rgb(0, 255, 0) : y < 50 ? rgb(0, 0, 255) : rgb(255, 255, 0);
      });
  const Camera camera{50, 50, 31.5, 31.5, 64, 64};
  const auto corner = [&](const View& view, int u, int v) {
    return view.rgba[static_cast<size_t>(v * view.width + u)] & 0xffffff;
  };
  const uint32_t south_west = 0x0000ff, north_west = 0x00ff00, south_east = 0xff0000, north_east = 0x00ffff;
  const View north_up = render(terrain, camera, looking_down({50, 50, 60}));
  EXPECT_EQ(corner(north_up, 3, 3), north_west);
  EXPECT_EQ(corner(north_up, 60, 3), north_east);
  EXPECT_EQ(corner(north_up, 3, 60), south_west);
  EXPECT_EQ(corner(north_up, 60, 60), south_east);
  EXPECT_NEAR(north_up.depth[0], 50, 1e-3);
  const View east_up = render(terrain, camera, looking_down({50, 50, 60}, M_PI / 2));
  EXPECT_EQ(corner(east_up, 3, 3), north_east);
  EXPECT_EQ(corner(east_up, 60, 60), south_west);
  // T_WC by its definition: a point ahead of the camera lies below it, one to its right lies in the east.
  SE3 T_WC = looking_down({50, 50, 60});
  EXPECT_TRUE((T_WC * Eigen::Vector3d(0, 0, 10)).isApprox(Eigen::Vector3d(50, 50, 50)));
  EXPECT_TRUE((T_WC * Eigen::Vector3d(1, 0, 0)).isApprox(Eigen::Vector3d(51, 50, 60)));
  // Moving 10 m east moves what is seen 10 pixels to the left: the seam between west and east.
  T_WC.t.x() += 10;
  const View moved = render(terrain, camera, T_WC);
  EXPECT_EQ(corner(moved, 20, 3), north_west);
  EXPECT_EQ(corner(moved, 23, 3), north_east);
}

/// Where a ray first falls below the surface, by small steps and bisection in double precision.
double march(const Terrain& terrain, const SE3& T_WC, const Eigen::Vector3d& d, double farthest) {
  const double step = 0.02 * terrain.relief.step_x / std::max(d.head<2>().norm(), 1e-3);
  const auto above = [&](double t) {
    const Eigen::Vector3d X = T_WC.t + t * d;
    const auto h = terrain.height_at(X.x(), X.y());
    return h ? X.z() - *h : NAN;
  };
  for (double t = step; t < farthest; t += step) {
    const double f = above(t);
    if (std::isnan(f)) return -1;
    if (f > 0) {
      t += 0.1 * f / d.norm() / 3;  // slopes are below 3 here
      continue;
    }
    double low = t - step - 0.1, high = t;
    while (low > 0 && above(low) < 0) low -= step;
    for (int i = 0; i < 60; ++i) (above(0.5 * (low + high)) > 0 ? low : high) = 0.5 * (low + high);
    return high;
  }
  return -1;
}

// Hills that hide each other, seen nearly along the ground: every pixel has the nearest of several crossings.
TEST(Renderer, NearestOfSeveralCrossings) {
  ICLK_NEED_DEVICE();
  std::mt19937 random(3);
  std::uniform_real_distribution<double> rough(0, 0.8);
  const Terrain terrain = make_terrain(
      square(100, 100, 231, 0.9), square(100, 100, 100, 2.5),
      [&](double x, double y) { return 9 * std::sin(x / 7) * std::cos(y / 5.5) + rough(random); },
      [](double, double) { return rgb(90, 90, 90); });
  const Camera camera{120, 120, 63.5, 35.5, 128, 72};
  for (const double heading : {0.0, 0.8, 1.5707963267948966, 4.1}) {
    const SE3 T_WC = looking_down({100 - 60 * std::sin(heading), 100 - 60 * std::cos(heading), 17}, heading, 1.25);
    const View view = render(terrain, camera, T_WC);
    int compared = 0, differ = 0, missed = 0;
    for (int v = 0; v < view.height; v += 3)
      for (int u = 0; u < view.width; u += 3) {
        const double z = march(terrain, T_WC, T_WC.R * camera.ray({u, v}), 400);
        const double seen = view.depth[static_cast<size_t>(v * view.width + u)];
        if (z < 0) continue;  // left the map
        ++compared;
        if (seen == 0) ++missed;
        if (std::abs(seen - z) > 1e-4 * z) ++differ;  // small steps can pass a crest that the exact ray touches
      }
    EXPECT_GT(compared, 500);
    EXPECT_LE(differ, compared / 200) << "heading " << heading;
    EXPECT_EQ(missed, 0);
  }
}

TEST(Renderer, WhatHasNoDataHasNoDepth) {
  ICLK_NEED_DEVICE();
  Terrain terrain = make_terrain(
      square(50, 50, 100, 1), square(50, 50, 200, 0.5), [](double, double) { return 10.0; },
      [](double x, double) { return x > 60 ? 0u : rgb(200, 100, 50); });
  for (int v = 30; v < 40; ++v)
    for (int u = 30; u < 40; ++u) terrain.height[static_cast<size_t>(v * 100 + u)] = NAN;
  const Camera camera{50, 50, 49.5, 49.5, 100, 100};
  const View view = render(terrain, camera, looking_down({50, 50, 60}), {.background = 0xff112233});
  const auto at = [&](int u, int v) { return static_cast<size_t>(v * 100 + u); };
  // A pixel is a metre; pixel (u, v) sees x = u + 0.5, y = 99.5 - v.
  for (const auto& [u, v, seen] : {std::tuple(10, 10, true),
                                   {35, 35, false},
                                   {28, 35, true},
                                   {41, 35, true},
                                   {35, 28, true},
                                   {35, 41, true},
                                   {58, 50, true},
                                   {61, 50, false},
                                   {80, 80, false}}) {
    EXPECT_EQ(view.depth[at(u, v)] > 0, seen) << u << ", " << v;
    EXPECT_EQ(view.rgba[at(u, v)], seen ? rgb(200, 100, 50) : 0xff112233) << "colours of no data must not bleed in";
  }
  // Through the hole, a slanted ray must not show the ground's lower side.
  const View slanted = render(terrain, camera, looking_down({35, 20, 30}, 0, 0.6));
  for (int v = 0; v < 100; ++v)
    for (int u = 0; u < 100; ++u) {
      const Eigen::Vector3d d = looking_down({35, 20, 30}, 0, 0.6).R * camera.ray({u, v});
      const double z = -20 / d.z();
      const float seen = slanted.depth[at(u, v)];
      ASSERT_TRUE(seen == 0 || std::abs(seen - z) < 1e-4 * z) << u << ", " << v << ": " << seen;
    }
}

TEST(Renderer, TheSameBitsEveryTimeAndFromWindows) {
  ICLK_NEED_DEVICE();
  const auto terrain = std::make_shared<Terrain>(procedural_terrain({.seed = 5, .size = 200}));
  const Camera camera{150, 150, 79.5, 59.5, 160, 120};
  const double ground = *terrain->height_at(100, 100);
  TerrainRenderer whole(test::device(), terrain), windows(test::device(), terrain, {.max_texels = 150000});
  EXPECT_TRUE(whole.resident());
  EXPECT_FALSE(windows.resident()) << "the mosaic has 640,000 texels";
  for (const SE3& T_WC : {looking_down({100, 100, ground + 90}), looking_down({90, 60, ground + 70}, 0.5, 0.4)}) {
    const View a = whole.render(camera, T_WC), b = whole.render(camera, T_WC), c = windows.render(camera, T_WC);
    EXPECT_EQ(a.rgba, b.rgba);
    EXPECT_EQ(a.depth, b.depth);
    EXPECT_EQ(a.depth, c.depth);
    EXPECT_EQ(a.rgba, c.rgba);
    EXPECT_EQ(std::count(a.depth.begin(), a.depth.end(), 0.0f), 0);
  }
  // A window that is too small for any tile at full resolution: coarser, not wrong.
  TerrainRenderer tiny(test::device(), terrain, {.max_texels = 60000});
  const SE3 T_WC = looking_down({100, 100, ground + 90});
  EXPECT_EQ(tiny.render(camera, T_WC).depth, whole.render(camera, T_WC).depth);
}

// On level ground a window's bounds are tight: what filtering reads beyond them must be there.
TEST(Renderer, WindowsReachAsFarAsFilters) {
  ICLK_NEED_DEVICE();
  std::mt19937 random(1);
  const auto terrain = std::make_shared<Terrain>(make_terrain(
      square(100, 100, 50, 4), square(100, 100, 800, 0.25), [](double, double) { return 10.0; },
      [&](double, double) { return static_cast<uint32_t>(random()) | 0xff000000u; }));
  TerrainRenderer whole(test::device(), terrain), windows(test::device(), terrain, {.max_texels = 40000});
  for (const SE3& T_WC : {looking_down({100, 100, 215}), looking_down({100, 90, 70}, 0.4, 0.5)})
    EXPECT_EQ(whole.render(kCamera, T_WC).rgba, windows.render(kCamera, T_WC).rgba);
}

TEST(Renderer, RecordsIntoForeignCommands) {
  ICLK_NEED_DEVICE();
  const auto terrain = std::make_shared<Terrain>(procedural_terrain({.seed = 2, .size = 100}));
  TerrainRenderer renderer(test::device(), terrain);
  const Camera camera{60, 60, 31.5, 23.5, 64, 48};
  const SE3 poses[2] = {looking_down({50, 50, 140}), looking_down({40, 55, 130}, 0.3, 0.1)};
  const Lens lenses[2] = {{}, Lens({Distortion::Model::radtan, {-0.2, 0.05, 0.001, 0}})};
  engine::MemoryPlan plan;
  std::vector<engine::BufferId> ids;
  for (int i = 0; i < 4; ++i)
    ids.push_back(plan.add("view", 64 * 48 * 4, engine::MemoryKind::readback, engine::BufferUse::storage));
  const engine::Workspace memory(test::device(), plan);
  engine::ArenaSize size;
  renderer.add_to(size, 2);
  engine::DescriptorArena arena(test::device(), size);
  engine::Submission submission(test::device());
  engine::Recorder recorder(submission, arena);
  for (size_t i = 0; i < 2; ++i)
    renderer.record(recorder, camera, poses[i], memory[ids[2 * i]], memory[ids[2 * i + 1]], lenses[i]);
  for (const engine::BufferId id : ids) recorder.host_read({&memory[id]});
  submission.end();
  submission.submit_and_wait();
  for (size_t i = 0; i < 2; ++i) {
    const View view = renderer.render(camera, poses[i], lenses[i]);
    EXPECT_EQ(std::memcmp(view.rgba.data(), memory[ids[2 * i]].mapped, view.rgba.size() * 4), 0);
    EXPECT_EQ(std::memcmp(view.depth.data(), memory[ids[2 * i + 1]].mapped, view.depth.size() * 4), 0);
  }
  TerrainRenderer windows(test::device(), terrain, {.max_texels = 50000});
  expect_error([&] { windows.record(recorder, camera, poses[0], memory[ids[0]], memory[ids[1]]); }, ErrorCode::unsupported,
               {"400x400"});
  expect_error(
      [&] {
        renderer.record(recorder, {60, 60, 40, 30, 80, 60}, poses[0], memory[ids[0]], memory[ids[1]]);
      },
      ErrorCode::invalid_argument, {"12288", "19200"});
}

// The code of docs/guide/render.md (tests/session/readme_test.cpp).
TEST(Renderer, CodeOfTheGuideWorks) {
  ICLK_NEED_DEVICE();
  const auto context = test::device();
  const Camera camera{60, 60, 31.5, 23.5, 64, 48};
  const SE3 T_WC = looking_down({500, 500, 300});
  engine::MemoryPlan plan;
  const auto kind = engine::MemoryKind::readback;
  const engine::BufferId ids[2] = {plan.add("rgba", 64 * 48 * 4, kind, engine::BufferUse::storage),
                                   plan.add("depth", 64 * 48 * 4, kind, engine::BufferUse::storage)};
  const engine::Workspace memory(context, plan);
  const engine::Buffer &rgba = memory[ids[0]], &depth = memory[ids[1]];
  engine::ArenaSize size;
  TerrainRenderer(context, std::make_shared<Terrain>(procedural_terrain({.seed = 7, .size = 100}))).add_to(size);
  engine::DescriptorArena arena(context, size);
  engine::Submission submission(context);
  engine::Recorder recorder(submission, arena);
  // README
  auto terrain = std::make_shared<iclk::Terrain>(iclk::procedural_terrain({.seed = 7}));  // or iclk::GeoMap(...).whole()
  iclk::TerrainRenderer renderer(context, terrain);
  iclk::View view = renderer.render(camera, T_WC);       // waits; view.image() goes into Reference or Pair as it is
  renderer.record(recorder, camera, T_WC, rgba, depth);  // or into your own commands and buffers
  // end
  recorder.host_read({&depth});
  submission.end();
  submission.submit_and_wait();
  EXPECT_EQ(std::memcmp(view.depth.data(), depth.mapped, view.depth.size() * 4), 0);
}

TEST(Renderer, RefusesWhatCannotBe) {
  ICLK_NEED_DEVICE();
  const Terrain good = make_terrain(
      square(50, 50, 20, 5), square(50, 50, 20, 5), [](double, double) { return 100.0; },
      [](double, double) { return rgb(1, 2, 3); });
  const SE3 above = looking_down({50, 50, 200});
  const auto refused = [&](auto change, std::initializer_list<const char*> pieces) {
    Terrain bad = good;
    change(bad);
    expect_error([&] { render(bad, kCamera, above); }, ErrorCode::invalid_argument, pieces);
  };
  refused([](Terrain& t) { t.height[7] = -32768; }, {"-32768", "nodata"});
  refused([](Terrain& t) { t.height[7] = INFINITY; }, {"inf"});
  refused([](Terrain& t) { t.height.assign(400, NAN); }, {"elevation has no data at any pixel"});
  refused([](Terrain& t) { t.rgba.assign(400, 0); }, {"mosaic has no data at any pixel"});
  refused([](Terrain& t) { t.mosaic.left += 500; }, {"overlap", "x 500 to 600", "gdalwarp"});
  refused([](Terrain& t) { t.relief.step_y = -5; }, {"-5"});
  refused([](Terrain& t) { t.height.pop_back(); }, {"399"});
  expect_error([&] { render(good, kCamera, looking_down({50, 50, 99})); }, ErrorCode::invalid_argument, {"99", "100", "above"});
  expect_error([&] { render(good, kCamera, looking_down({50, NAN, 200})); }, ErrorCode::invalid_argument, {"NaN"});
  expect_error(
      [&] {
        render(good, kCamera, {2 * Eigen::Matrix3d::Identity(), {50, 50, 200}});
      },
      ErrorCode::invalid_argument, {"rotation"});
  expect_error([&] { render(good, kCamera, looking_down({50, 1e12, 200})); }, ErrorCode::invalid_argument, {"1e+12"});
  expect_error([&] { render(good, kCamera, above, {.samples = 9}); }, ErrorCode::invalid_argument, {"9", "1 to 8"});
  expect_error([&] { render(good, {0, 1, 2, 3, 4, 5}, above); }, ErrorCode::invalid_argument, {"focal"});
  // Past the map's edge there is nothing to see, and that is no error.
  const View nothing = render(good, kCamera, looking_down({5000, 50, 200}));
  EXPECT_EQ(std::count(nothing.depth.begin(), nothing.depth.end(), 0.0f), 192 * 120);
  const View sky = render(good, kCamera, {Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitX()) * above.R, {50, 50, 200}});
  EXPECT_EQ(std::count(sky.depth.begin(), sky.depth.end(), 0.0f), 192 * 120);
}

}  // namespace
}  // namespace iclk
