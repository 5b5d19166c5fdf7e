// One place on two dates: the ground stays, colours and shadows do not.
#include <gtest/gtest.h>

#include <iclk/align/common/input.h>
#include <iclk/align/search/gradients.h>
#include <iclk/refine/cascade.h>
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

/// A pair of two seasons, with features on a lattice.
struct TwoSeasons {
  explicit TwoSeasons(uint64_t index) {
    const auto terrain = [](Season season, uint64_t year) {
      return std::make_shared<const Terrain>(procedural_terrain({.seed = 6, .size = 384, .date = Date::of(season, year)}));
    };
    static TerrainRenderer summer(test::device(), terrain(Season::summer, 0)),
        winter(test::device(), terrain(Season::winter, 1));
    PairOptions options;
    options.camera = camera;
    options.altitude_min = 80, options.altitude_max = 100;
    options.translation = 12;
    pair = PairSource(summer, options, &winter).draw(index);
    for (int v = 14; v < camera.height - 14; v += 16)
      for (int u = 14; u < camera.width - 14; u += 16) {
        features.uv.emplace_back(u, v);
        features.inverse_depth.push_back(1 / static_cast<double>(pair.view0.depth[static_cast<size_t>(v * camera.width + u)]));
      }
    checks = check_features(features, camera);
  }
  /// px, median of the features.
  double error(const SE3& T_10) const {
    std::vector<double> errors;
    for (size_t i = 0; i < features.uv.size(); ++i) {
      const Eigen::Vector3d X = camera.ray(features.uv[i]) / features.inverse_depth[i];
      errors.push_back((camera.project(T_10 * X) - camera.project(pair.T_10 * X)).norm());
    }
    std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2), errors.end());
    return errors[errors.size() / 2];
  }
  CascadePair given() const { return {{pair.view0.image(), camera, features, {}}, pair.view1.image(), {}}; }

  Camera camera{227.5, 227.5, 187.5, 119.5, 376, 240};
  RenderedPair pair;
  Features features;
  std::vector<FeatureCheck> checks;
};

TEST(Dates, GradientsFindStartsThatGreyValuesDoNot) {
  ICLK_NEED_DEVICE();
  int grey = 0, gradients = 0;
  constexpr int kPairs = 6;
  for (uint64_t i = 0; i < kPairs; ++i) {
    const TwoSeasons s(i);
    const internal::MatchLayout layout = internal::match_layout(s.camera);
    const Reference reference = s.given().reference;
    const auto map = [&](const View& view) { return internal::match_map(grey_map(view.image()), layout); };
    const double mean_q = internal::mean_inverse_depth(reference, s.checks, false);
    const auto by_grey =
        internal::matched_start(map(s.pair.view0), map(s.pair.view1), s.features, s.checks, s.camera, mean_q, layout);
    const auto by_gradients = internal::start_by_gradients(reference, s.checks, {0, s.pair.view1.image()}, 0);
    grey += by_grey.T_10 && s.error(*by_grey.T_10) < 5;
    gradients += by_gradients && s.error(*by_gradients) < 5;
  }
  EXPECT_GE(gradients, kPairs - 1);
  EXPECT_LE(grey, kPairs / 2);
}

TEST(Dates, PairsThatGreyValuesLoseAreAlignedFromSuchAStart) {
  ICLK_NEED_DEVICE();
  Plan plan{376, 240};
  plan.max_features = 400;
  const auto make = [plan] {
    AlignerOptions options;
    options.search = true;
    return make_cpu_aligner(plan, options);
  };
  Cascade without({{"grey", make, RefinerOptions()}}), with({{"grey", make, RefinerOptions(), true, true}});
  int before = 0, after = 0;
  for (uint64_t i = 0; i < 6; ++i) {
    const TwoSeasons s(i);
    const CascadePair pair = s.given();
    const RefinedAlignment first = without.align(std::span(&pair, 1))[0], r = with.align(std::span(&pair, 1))[0];
    before += s.error(first.T_10) < 2, after += s.error(r.T_10) < 2;
    EXPECT_TRUE(!r.converged() || s.error(r.T_10) < 2) << i << ": " << r.reason;
    if (first.converged()) continue;
    ASSERT_GE(r.attempts.size(), 2u);
    EXPECT_EQ(r.attempts[1].model, "grey, gradients");
    CascadePair guessed = pair;
    guessed.search = false;
    const RefinedAlignment kept = with.align(std::span(&guessed, 1))[0];
    for (const Attempt& attempt : kept.attempts) EXPECT_NE(attempt.model, "grey, gradients") << "a first guess is kept";
  }
  EXPECT_GE(after, before + 2);
}

}  // namespace
}  // namespace iclk
