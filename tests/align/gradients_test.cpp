// Starts by the directions of gradients. Pairs of two seasons: tests/apps/dates_test.cpp.
#include <iclk/align/common/input.h>
#include <iclk/align/search/gradients.h>

#include "solvers.h"

namespace iclk::test {
namespace {

using Eigen::Vector2d;

Relief far_apart(uint32_t seed) {
  Relief scene;
  scene.camera = {260, 260, 159.5, 119.5, 320, 240};
  scene.seed = seed;
  Vector6d xi;
  xi << 0.7, -0.3, 0.2, 0.03, -0.05, 0.04;
  scene.T_10 = SE3::exp(xi);
  return scene;
}

struct Pairing {
  explicit Pairing(uint32_t seed) : scene(far_apart(seed)), features(random_features(scene, 120)) {
    image0 = render(scene, 0), image1 = render(scene, 1);
    reference = {image0.view(), scene.camera, features, {}};
    checks = check_features(features, scene.camera);
  }
  std::optional<SE3> start(const Pair& pair, int threads = 1) const {
    return internal::start_by_gradients(reference, checks, pair, threads);
  }

  Relief scene;
  Features features;
  Frame image0, image1;
  Reference reference;
  std::vector<FeatureCheck> checks;
};

TEST(Gradients, FindWhatIsFarAwayInOtherLight) {
  for (uint32_t seed = 1; seed <= 3; ++seed) {
    Pairing s(seed);
    for (float& x : s.image1.data) x = 0.1f + 0.4f * x * x;
    const auto start = s.start({0, s.image1.view()});
    ASSERT_TRUE(start) << seed;
    EXPECT_LT(pixel_error(s.scene, s.features, *start), 4) << seed;
  }
}

TEST(Gradients, FindAnyRoll) {
  for (int degrees = 0; degrees < 360; degrees += 40) {
    Relief scene = far_apart(1);
    scene.T_10.R = Eigen::AngleAxisd(degrees * M_PI / 180, Eigen::Vector3d::UnitZ()).toRotationMatrix() * scene.T_10.R;
    const Features features = random_features(scene, 120);
    const Frame image0 = render(scene, 0), image1 = render(scene, 1);
    const auto start = internal::start_by_gradients({image0.view(), scene.camera, features, {}},
                                                    check_features(features, scene.camera), {0, image1.view()}, 1);
    ASSERT_TRUE(start) << degrees;
    EXPECT_LT(pixel_error(scene, features, *start), 4) << degrees;
  }
}

TEST(Gradients, TheEdgesOfAMaskAreNoTexture) {
  const Pairing s(1);
  std::vector<uint8_t> mask(320 * 240, 255);
  for (int v = 0; v < 240; ++v)
    for (int u = 0; u < 320; ++u)
      if (u % 24 < 4 && v % 24 < 4) mask[static_cast<size_t>(v * 320 + u)] = 0;
  Pair masked{0, s.image1.view()};
  masked.target_mask = {mask.data(), 320, 240, 0, PixelFormat::r8};
  const auto start = s.start(masked);
  ASSERT_TRUE(start);
  EXPECT_LT(pixel_error(s.scene, s.features, *start), 4);
}

TEST(Gradients, ThreadsChangeNothing) {
  const Pairing s(1);
  const auto one = s.start({0, s.image1.view()}), three = s.start({0, s.image1.view()}, 3);
  ASSERT_TRUE(one && three);
  EXPECT_EQ(one->matrix(), three->matrix());
}

TEST(Gradients, NothingIsFoundWhereNothingIs) {
  Pairing s(1);
  const Pairing other(9);
  EXPECT_FALSE(s.start({0, other.image1.view()})) << "another place";
  const Frame flat{320, 240, std::vector<float>(320 * 240, 0.5f)}, nan{320, 240, std::vector<float>(320 * 240, NAN)};
  EXPECT_FALSE(s.start({0, flat.view()}));
  EXPECT_FALSE(s.start({0, nan.view()}));
  Frame one_infinite = s.image1;
  one_infinite.at(160, 120) = INFINITY;
  const internal::Gradients gradients(grey_map(one_infinite.view()), 2, 1);
  using Patch = internal::Gradients::Patch;
  for (const Patch* patch : {&Patch::small(), &Patch::large()})
    EXPECT_TRUE(gradients.describe({{80, 60}, {20, 20}}, *patch).allFinite());
  std::vector<uint8_t> hidden(320 * 240, 0);
  Pair masked{0, s.image1.view()};
  masked.target_mask = {hidden.data(), 320, 240, 0, PixelFormat::r8};
  EXPECT_FALSE(s.start(masked)) << "all of it is hidden";
  std::fill(s.checks.begin(), s.checks.end(), FeatureCheck::no_depth);
  EXPECT_FALSE(s.start({0, s.image1.view()}));
  const Frame small{16, 12, std::vector<float>(16 * 12, 0.5f)};
  Relief tiny;
  tiny.camera = {20, 20, 7.5, 5.5, 16, 12};
  EXPECT_FALSE(internal::start_by_gradients({small.view(), tiny.camera, {}, {}}, {}, {0, small.view()}, 1));
}

TEST(Gradients, AWallThatRepeatsHasNoStart) {
  Relief flat = far_apart(1);
  flat.depth_amplitude = 0;
  const Features features = random_features(flat, 120);
  const Frame image0 = chequered(320, 240, 0, 1), image1 = chequered(320, 240, 5, 2);
  EXPECT_FALSE(internal::start_by_gradients({image0.view(), flat.camera, features, {}}, check_features(features, flat.camera),
                                            {0, image1.view()}, 1))
      << "to choose one of many poses would be a guess";
}

class Found : public Solvers {};

// A pair with a start begins there, at the level of the search, and leaves the others of its batch alone.
TEST_P(Found, AStartIsUsedInsteadOfASearch) {
  const Relief scene = far_apart(1);
  const Features features = random_features(scene, 120);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  Plan plan = plan_for(scene.camera, 120);
  plan.max_pairs = 3;
  AlignerOptions options;
  options.levels = 4;
  options.search = true;
  const auto aligner = make_aligner(way(), plan, options);
  aligner->set_reference(0, {image0.view(), scene.camera, features, {}});
  SE3 near = scene.T_10;
  near.t.x() += 0.02;
  Pair searched{0, image1.view()}, found{0, image1.view(), near}, wrong{0, image1.view()};
  found.found = wrong.found = true;
  const Pair pairs[] = {searched, found, wrong};
  const auto results = aligner->align(pairs);
  for (const size_t i : {0, 1}) {
    EXPECT_TRUE(results[i].converged()) << results[i].reason;
    EXPECT_LT(pixel_error(scene, features, results[i].T_10), 0.5);
    ASSERT_EQ(results[i].levels.size(), 4u);
    EXPECT_TRUE(results[i].levels[0].iterations.empty() && results[i].levels[1].iterations.empty());
    EXPECT_FALSE(results[i].levels[2].iterations.empty()) << "the map that is searched is that of level 1";
  }
  EXPECT_FALSE(results[2].converged()) << "it began at no motion, although a search would have found it";
}

INSTANTIATE_TEST_SUITE_P(All, Found, testing::Values(Way::cpu, Way::host, Way::device, Way::split), way_name);

}  // namespace
}  // namespace iclk::test
