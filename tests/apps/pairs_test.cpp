// What pairs are drawn, and which are not.
#include <random>

#include <gtest/gtest.h>

#include <iclk/render/pairs.h>
#include <iclk/render/procedural.h>

#include "device.h"
#include "files.h"
#include "render_fixture.h"

namespace iclk {
namespace {

using test::expect_error;

/// The default's field of view with an eighth of its pixels.
PairOptions small_options() {
  PairOptions options;
  options.camera = {455 / 8.0, 455 / 8.0, 46.5, 29.5, 94, 60};
  return options;
}

TerrainRenderer make_renderer(const Terrain& terrain) {
  return {test::device(), std::make_shared<Terrain>(terrain), {.samples = 1}};
}

const Terrain& landscape() {
  static const Terrain terrain = procedural_terrain({.seed = 4, .size = 700, .mosaic_step = 2, .relief_step = 2});
  return terrain;
}

TEST(Pairs, StartAsFarFromTheTruthAsThePaper) {
  ICLK_NEED_DEVICE();
  TerrainRenderer renderer = make_renderer(landscape());
  const PairOptions options = small_options();
  PairSource source(renderer, options);
  std::mt19937 random(1);
  double e_pixel = 0, e_transl = 0, e_rot = 0;
  constexpr int kPairs = 150, kFeatures = 50;
  for (int i = 0; i < kPairs; ++i) {
    const RenderedPair pair = source.draw(static_cast<uint64_t>(i));
    e_transl += pair.T_10.t.norm() / kPairs;
    e_rot += pair.T_10.angle() / kPairs;
    for (int k = 0; k < kFeatures; ++k) {
      const int u = 3 + static_cast<int>(random() % 88), v = 3 + static_cast<int>(random() % 54);
      const Eigen::Vector3d X = options.camera.ray({u, v}) * pair.view0.depth[static_cast<size_t>(v * 94 + u)];
      e_pixel += 8 * (options.camera.project(X) - options.camera.project(pair.T_10 * X)).norm() / (kPairs * kFeatures);
    }
  }
  EXPECT_NEAR(e_pixel, 34, 3);
  EXPECT_NEAR(e_transl, 4.9, 0.3);
  EXPECT_NEAR(e_rot, 0.075, 0.004);
}

TEST(Pairs, KeepToTheirBounds) {
  ICLK_NEED_DEVICE();
  Terrain terrain = landscape();
  // A lake without picture in the north, and a hole in the elevation in the west.
  for (int v = 0; v < 60; ++v)
    for (int u = 150; u < 250; ++u) terrain.rgba[static_cast<size_t>(v * terrain.mosaic.width + u)] = 0;
  for (int v = 170; v < 180; ++v)
    for (int u = 10; u < 20; ++u) terrain.height[static_cast<size_t>(v * terrain.relief.width + u)] = NAN;
  TerrainRenderer renderer = make_renderer(terrain);
  PairOptions options = small_options();
  options.region = {0, 0.25, 0.75, 1};
  options.altitude_min = 60, options.altitude_max = 110;
  PairSource source(renderer, options);
  EXPECT_NEAR(source.region().right, 0.75 * 700, 2);
  const Camera& camera = options.camera;
  double lowest = 1e9, highest = 0, steepest = 0;
  for (uint64_t i = 0; i < 25; ++i) {
    const RenderedPair pair = source.draw(i);
    EXPECT_TRUE((pair.T_W1.inverse() * pair.T_W0).matrix().isApprox(pair.T_10.matrix(), 1e-12));
    const SE3 T_01 = pair.T_10.inverse();
    EXPECT_LE(T_01.t.cwiseAbs().maxCoeff(), options.translation);
    EXPECT_LE(T_01.log().tail<3>().cwiseAbs().maxCoeff(), options.rotation + 1e-9);
    const double tilt = std::acos(-pair.T_W0.R(2, 2));
    EXPECT_LE(tilt, options.tilt + 1e-9);
    EXPECT_NEAR(pair.T_W0.t.z() - *terrain.height_at(pair.T_W0.t.x(), pair.T_W0.t.y()), pair.altitude, 1e-9);
    lowest = std::min(lowest, pair.altitude), highest = std::max(highest, pair.altitude), steepest = std::max(steepest, tilt);
    for (const auto& [view, T_WC] : {std::pair(&pair.view0, pair.T_W0), {&pair.view1, pair.T_W1}})
      for (int v = 0; v < 60; ++v)
        for (int u = 0; u < 94; ++u) {
          const float z = view->depth[static_cast<size_t>(v * 94 + u)];
          ASSERT_GT(z, 0.3 * pair.altitude) << "missing data, or too near";
          const Eigen::Vector3d X = T_WC * (z * camera.ray({u, v}));
          ASSERT_TRUE(source.region().contains(X.x(), X.y())) << X.transpose();
        }
  }
  EXPECT_LT(lowest, 68);
  EXPECT_GT(highest, 102);
  EXPECT_GT(steepest, 0.2);
  EXPECT_GT(source.rejected().outside, 0);
}

TEST(Pairs, OrbitsLookAtOnePointOfTheGround) {
  ICLK_NEED_DEVICE();
  TerrainRenderer renderer = make_renderer(landscape());
  PairOptions options = small_options();
  options.altitude_min = 50, options.altitude_max = 70;
  options.tilt = 0.8, options.rotation = 0;
  options.orbit_min = 0.2, options.orbit_max = 0.5;
  options.start_min = 8, options.start_max = 16;
  PairSource source(renderer, options);
  int left = 0, higher = 0;
  double steepest = 0;
  constexpr int kPairs = 25;
  for (uint64_t i = 0; i < kPairs; ++i) {
    const RenderedPair pair = source.draw(i);
    EXPECT_TRUE((pair.T_W1.inverse() * pair.T_W0).matrix().isApprox(pair.T_10.matrix(), 1e-12));
    // The optical axes, C + s z, meet below the cameras.
    const Eigen::Vector3d z0 = pair.T_W0.R.col(2), z1 = pair.T_W1.R.col(2);
    Eigen::Matrix<double, 3, 2> axes;
    axes << z0, -z1;
    const Eigen::Vector2d s = axes.colPivHouseholderQr().solve(pair.T_W1.t - pair.T_W0.t);
    const Eigen::Vector3d point = pair.T_W0.t + s.x() * z0;
    EXPECT_LT((axes * s - (pair.T_W1.t - pair.T_W0.t)).norm(), 1e-9);
    EXPECT_NEAR(point.z(), *landscape().height_at(point.x(), point.y()), 1e-6);
    EXPECT_NEAR(pair.T_W0.t.z() - point.z(), pair.altitude, 1e-6);
    for (const SE3& T_WC : {pair.T_W0, pair.T_W1}) {
      EXPECT_NEAR(T_WC.R(2, 0), 0, 1e-12) << "level";
      EXPECT_LT(T_WC.R(2, 1), 0) << "the image's top is up";
      EXPECT_TRUE((T_WC.R.transpose() * T_WC.R).isIdentity(1e-12) && T_WC.R.determinant() > 0);
    }
    const Eigen::Vector2d a = (pair.T_W0.t - point).head<2>(), b = (pair.T_W1.t - point).head<2>();
    EXPECT_NEAR(a.norm(), b.norm(), 1e-6);
    // The level axis of a camera says where it looks from, straight above the point too.
    const double turned =
        std::atan2(pair.T_W0.R.col(0).cross(pair.T_W1.R.col(0)).z(), pair.T_W0.R.col(0).dot(pair.T_W1.R.col(0)));
    EXPECT_GE(std::abs(turned), options.orbit_min - 1e-9);
    EXPECT_LE(std::abs(turned), options.orbit_max + 1e-9);
    const double higher_by = (pair.T_W1.t.z() - point.z()) / pair.altitude;
    EXPECT_GE(higher_by, 0.8 - 1e-9);
    EXPECT_LE(higher_by, 1.25 + 1e-9);
    left += turned > 0, higher += higher_by > 1;
    steepest = std::max(steepest, std::acos(-z0.z()));
    double start = 0;
    for (int v = 0; v < 60; ++v)
      for (int u = 0; u < 94; ++u) {
        const Eigen::Vector3d X = options.camera.ray({u, v}) * pair.view0.depth[static_cast<size_t>(v * 94 + u)];
        start += (options.camera.project(X) - options.camera.project(pair.T_10 * X)).norm() / (94 * 60);
      }
    EXPECT_GE(start, 0.85 * options.start_min);
    EXPECT_LE(start, 1.15 * options.start_max);
  }
  EXPECT_GT(steepest, 0.6);
  EXPECT_LE(steepest, 0.8 + 1e-9);
  for (const int n : {left, higher}) EXPECT_TRUE(n > 4 && n < kPairs - 4) << n << ": both sides, both ways";
  EXPECT_GT(source.rejected().start, 0);
  EXPECT_NE(source.rejected().text().find("start"), std::string::npos);
}

TEST(Pairs, SeedsDecideEverything) {
  ICLK_NEED_DEVICE();
  TerrainRenderer renderer = make_renderer(landscape());
  PairOptions options = small_options();
  PairSource forwards(renderer, options), backwards(renderer, options);
  const RenderedPair a0 = forwards.draw(0), a1 = forwards.draw(1), b1 = backwards.draw(1), b0 = backwards.draw(0);
  EXPECT_EQ(a0.T_W0.matrix(), b0.T_W0.matrix());
  EXPECT_EQ(a1.T_10.matrix(), b1.T_10.matrix());
  EXPECT_EQ(a0.view1.rgba, b0.view1.rgba);
  EXPECT_EQ(a1.view0.depth, b1.view0.depth);
  EXPECT_NE(a0.T_W0.matrix(), a1.T_W0.matrix());
  options.seed = 1;
  EXPECT_NE(PairSource(renderer, options).draw(0).T_W0.matrix(), a0.T_W0.matrix());
}

TEST(Pairs, ProceduralTerrainDependsOnTheSeedAlone) {
  const auto make = [](uint64_t seed, int threads) {
    return procedural_terrain({.seed = seed, .size = 60, .threads = threads}).hash();
  };
  EXPECT_EQ(make(1, 1), make(1, 3));
  EXPECT_NE(make(1, 0), make(2, 0));
  const Terrain terrain = procedural_terrain({.seed = 1, .size = 60});
  EXPECT_EQ(terrain.extent().text(), "x 0 to 60, y 0 to 60") << "ground lies under all of the mosaic";
}

TEST(Pairs, NoRoomIsSaid) {
  ICLK_NEED_DEVICE();
  TerrainRenderer renderer = make_renderer(landscape());
  PairOptions options = small_options();
  options.region = {0.4, 0.4, 0.5, 0.6};
  PairSource source(renderer, options);
  expect_error([&] { source.draw(0); }, ErrorCode::invalid_argument, {"165 x 105 m", "70 x 140 m", "altitudes"});
  const auto refused = [&](auto change, std::initializer_list<const char*> pieces) {
    PairOptions bad = small_options();
    change(bad);
    expect_error([&] { PairSource(renderer, bad); }, ErrorCode::invalid_argument, pieces);
  };
  refused([](PairOptions& o) { o.region = {0.5, 0, 0.5, 1}; }, {"0.5,0,0.5,1", "x0 < x1"});
  refused([](PairOptions& o) { o.region = {0, 0, 1.5, 1}; }, {"1.5"});
  refused([](PairOptions& o) { o.region = {0, NAN, 1, 1}; }, {"nan"});
  refused([](PairOptions& o) { o.altitude_max = 50; }, {"100 to 50"});
  refused([](PairOptions& o) { o.tilt = 2; }, {"tilt"});
  refused([](PairOptions& o) { o.translation = -1; }, {"-1 m"});
  refused([](PairOptions& o) { o.rotation = NAN; }, {"nan rad"});
  refused([](PairOptions& o) { o.orbit_min = 0.5, o.orbit_max = 0.25; }, {"28.6", "14.3", "ascending"});
  refused([](PairOptions& o) { o.orbit_max = NAN; }, {"nan degrees"});
  refused([](PairOptions& o) { o.start_min = 50, o.start_max = 40; }, {"50 to 40 px"});
  options = small_options();
  options.start_min = 5000;
  PairSource nowhere(renderer, options);
  expect_error([&] { nowhere.draw(0); }, ErrorCode::invalid_argument, {"because of --start", "another --start"});
}

}  // namespace
}  // namespace iclk
