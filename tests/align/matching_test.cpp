// Starts by matching: the minimal solver, the descriptors, and whole pairs far outside the basin, by every solver alike.
#include <iclk/align/device_recording.h>
#include <iclk/align/search/matching.h>
#include <iclk/align/search/p3p.h>

#include "host_application.h"
#include "solvers.h"

namespace iclk::test {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

SE3 random_pose(std::mt19937& random, double turn, double shift) {
  std::uniform_real_distribution<double> x(-1, 1);
  Vector6d xi;
  for (int i = 0; i < 6; ++i) xi(i) = x(random) * (i < 3 ? shift : turn);
  return SE3::exp(xi);
}

TEST(P3P, FindsThePoseOfRandomTriples) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> x(-1, 1);
  int wanted = 0, found = 0;
  for (int n = 0; n < 2000; ++n) {
    const SE3 truth = random_pose(random, 1.5, 1);
    std::array<Vector3d, 3> points, rays;
    bool ahead = true;
    for (size_t i = 0; i < 3; ++i) {
      points[i] = truth.inverse() * Vector3d(x(random) * 2, x(random) * 2, 4 + 2 * x(random));
      rays[i] = (truth * points[i]) * (0.5 + 0.4 * x(random));  // of any length
      ahead = ahead && rays[i].z() > 0;
    }
    ASSERT_TRUE(ahead);
    ++wanted;
    const auto poses = internal::p3p(points, rays);
    EXPECT_LE(poses.size(), 4u);
    bool near = false;
    for (const SE3& T : poses) {
      near = near || distance(T, truth, 4) < 1e-6;
      for (size_t i = 0; i < 3; ++i)  // every solution sees the points where they are seen, and before the camera
        EXPECT_LT(((T * points[i]).normalized() - rays[i].normalized()).norm(), 1e-4);
    }
    found += near;
  }
  EXPECT_GE(found, wanted * 0.998);
}

TEST(P3P, DegenerateTriplesHaveNoPoseOrAFiniteOne) {
  const Vector3d a(0, 0, 4), b(1, 0, 4), c(2, 0, 4), d(0.3, 1, 5);
  const std::array<Vector3d, 3> triples[] = {{a, b, c}, {a, a, d}, {a, a, a}, {d, d, b}};
  for (const auto& points : triples)
    for (const auto& rays : triples)
      for (const SE3& T : internal::p3p(points, rays)) EXPECT_TRUE(T.matrix().allFinite());
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(internal::p3p({a, b, d}, {a, b, Vector3d(nan, 0, 1)}).empty());
}

Plan plan_of(const Relief& scene) { return plan_for(scene.camera, 120); }

AlignerOptions matching() {
  AlignerOptions options;
  options.levels = 3;
  options.search = true;
  return options;
}

// Sideways by a quarter of the distance: near things move 110 px of 320, far ones 55.
Relief parallax(uint32_t seed = 1) {
  Relief scene;
  scene.camera = {300, 300, 159.5, 119.5, 320, 240};
  scene.seed = seed;
  scene.depth_amplitude = 0.3;
  scene.shortest = 10;
  scene.longest = 80;  // no long waves that lead there
  Vector6d xi;
  xi << (seed % 2 ? 1.0 : -1.0), (seed % 3 ? 0.3 : -0.3), 0.3, 0.02, 0.03, 0.1;
  scene.T_10 = SE3::exp(xi);
  return scene;
}

TEST(Matching, DescriptorsKnowNoLightAndNoFlatGround) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> x(0, 1);
  std::array<float, ICLK_PATCH_AREA> patch, brighter, flat;
  for (size_t i = 0; i < patch.size(); ++i) {
    patch[i] = x(random);
    brighter[i] = 0.3f + 0.5f * patch[i];
    flat[i] = 0.7f + 1e-4f * x(random);
  }
  const auto a = internal::describe(patch), b = internal::describe(brighter), c = internal::describe(flat);
  float same = 0, size = 0;
  for (size_t i = 0; i < a.size(); ++i) {
    same += a[i] * b[i];
    size += a[i] * a[i];
    EXPECT_EQ(c[i], 0);
  }
  EXPECT_NEAR(size, 1, 1e-5);
  EXPECT_NEAR(same, 1, 1e-4);
  patch[5] = std::numeric_limits<float>::quiet_NaN();
  for (const float v : internal::describe(patch)) EXPECT_EQ(v, 0);
}

TEST(Matching, MostCorrespondencesAreTrue) {
  const Relief scene = parallax();
  const internal::MatchLayout layout(plan_of(scene), matching());
  ASSERT_TRUE(layout.enabled);
  EXPECT_EQ(layout.scale, 2);
  const Features features = random_features(scene, 120);
  const auto checks = check_features(features, scene.camera);
  const Map map0 = internal::match_map(grey_map(render(scene, 0).view()), layout),
            map1 = internal::match_map(grey_map(render(scene, 1).view()), layout);
  const auto all = internal::correspondences(map0, map1, features, checks, scene.camera, 1, layout, internal::Rolls::all);
  int inside = 0, near = 0;
  for (const auto& c : all) {
    const Vector3d X = scene.T_10 * c.point;
    const Vector2d truth = scene.camera.project(X);
    if (truth.x() < 8 || truth.y() < 8 || truth.x() > 311 || truth.y() > 231) continue;
    ++inside;
    near += (c.pixel - truth).norm() < 3;
  }
  EXPECT_GE(inside, 40);
  EXPECT_GE(near, inside / 2);
  for (size_t i = 1; i < all.size(); ++i) EXPECT_LE(all[i].distinct, all[i - 1].distinct);
  const auto start = internal::pose_of(all, scene.camera, 1, layout, ICLK_MATCH_HYPOTHESES, ICLK_MATCH_SHARE);
  ASSERT_TRUE(start);
  EXPECT_LT(pixel_error(scene, features, start->T_10), 1.5);

  auto with_far = all;
  with_far.push_back({scene.camera.ray({100, 100}) * 1e60, {100, 100}, 0});  // no float holds that
  const auto same = internal::pose_of(with_far, scene.camera, 1, layout, ICLK_MATCH_HYPOTHESES, ICLK_MATCH_SHARE);
  ASSERT_TRUE(same);
  EXPECT_LT(pixel_error(scene, features, same->T_10), 1.5);
}

TEST(Matching, WhatAgreesOnNothingIsNotBelieved) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> x(0, 1);
  const Relief scene;
  const internal::MatchLayout layout(plan_of(scene), matching());
  for (const int count : {0, 3, 4, 5, 12, 50, 200}) {
    std::vector<internal::Correspondence> all;
    for (int i = 0; i < count; ++i)
      all.push_back(
          {scene.camera.ray({160 * x(random), 120 * x(random)}) * (1 + x(random)), {160 * x(random), 120 * x(random)}, 0});
    EXPECT_FALSE(internal::pose_of(all, scene.camera, 1, layout, ICLK_MATCH_HYPOTHESES, ICLK_MATCH_SHARE)) << count;
  }
}

class Matched : public Solvers {};

TEST_P(Matched, FindsWhatIsFarAway) {
  int missed = 0;
  for (uint32_t seed = 1; seed <= 4; ++seed) {
    const Relief scene = parallax(seed);
    const Features features = random_features(scene, 120);
    const Frame image0 = render(scene, 0), image1 = render(scene, 1);
    AlignerOptions at_guess = matching();
    at_guess.search = false;
    const Alignment found = align_once(way(), scene, image0, image1, features, matching());
    EXPECT_TRUE(found.converged()) << seed << ": " << found.reason;
    EXPECT_LT(pixel_error(scene, features, found.T_10), 0.5) << seed;  // one depth a patch, on steep ground
    missed += !align_once(way(), scene, image0, image1, features, at_guess).converged();
    const Alignment expected = align_once(Way::cpu, scene, image0, image1, features, matching());
    EXPECT_LT(distance(found.T_10, expected.T_10, scene.distance), 1e-5) << seed;
  }
  EXPECT_GE(missed, 3) << "not far enough to need matching";
}

// The pose with which the first level begins that takes steps: solvers agree on it, and coarser levels take none.
TEST_P(Matched, BeginsWhereTheCpuReferenceDoesAtTheSameLevel) {
  const Relief scene = parallax();
  const Features features = random_features(scene, 100);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  for (const double carry : {0.0, 0.1}) {
    AlignerOptions options = matching();
    options.levels = 4;
    options.carry = carry;
    options.iterations = 3;
    const Alignment expected = align_once(Way::cpu, scene, image0, image1, features, options);
    const Alignment a = align_once(way(), scene, image0, image1, features, options);
    ASSERT_EQ(a.levels.size(), 4u);
    for (size_t l = 0; l < 4; ++l) {
      EXPECT_EQ(a.levels[l].iterations.empty(), l < 2) << l;  // coarsest first; the map is that of level 1
      EXPECT_EQ(expected.levels[l].iterations.empty(), l < 2) << l;
    }
    EXPECT_LT(distance(a.levels[2].iterations.at(0).T_10, expected.levels[2].iterations.at(0).T_10, scene.distance), 2e-4);
    EXPECT_LT(distance(a.T_10, expected.T_10, scene.distance), 2e-5) << carry;
  }
}

TEST_P(Matched, AScantPairDisturbsNobodyInItsBatch) {
  const Relief scene = parallax();
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  Plan plan = plan_of(scene);
  plan.max_references = plan.max_pairs = 5;
  const auto aligner = make_aligner(way(), plan, matching());
  std::vector<Pair> pairs;
  const int usable[] = {120, 0, 3, 5, 120};
  for (int i = 0; i < 5; ++i) {
    Features features = random_features(scene, 120);
    for (size_t k = 0; k < 120; ++k)
      if (static_cast<int>(k) >= usable[i]) features.inverse_depth[k] = 0;
    aligner->set_reference(i, {image0.view(), scene.camera, features, {}});
    pairs.push_back({i, image1.view(), {}, {}});
  }
  const auto results = aligner->align(pairs);
  EXPECT_TRUE(results[0].converged()) << results[0].reason;
  for (const size_t i : {1, 2, 3}) EXPECT_EQ(results[i].status, Status::too_few_features) << i;
  EXPECT_TRUE(same_bits(results[0], results[4])) << "a start does not depend on the place in the batch";
}

// Of patches that are rolled by more than some 30 degrees no place is like the feature (docs/guide/limits.md).
TEST_P(Matched, RollsAreFoundUpToALimitAndNeverClaimedWrongly) {
  for (const double roll : {0.5, -0.5, M_PI / 2, M_PI}) {
    Relief scene;
    scene.shortest = 9;
    Vector6d xi = Vector6d::Zero();
    xi(0) = 0.5;
    xi(5) = roll;
    scene.T_10 = SE3::exp(xi);
    const Features features = random_features(scene, 120);
    const Alignment a = align_once(way(), scene, render(scene, 0), render(scene, 1), features, matching());
    const double error = pixel_error(scene, features, a.T_10);
    EXPECT_TRUE(!a.converged() || error < 0.2) << roll << ": " << error << " px, " << a.reason;
    if (std::abs(roll) < 1) {
      EXPECT_TRUE(a.converged()) << roll << ": " << a.reason;
    }
  }
}

// One that is matched as it stands, one that must be rolled, one that is not matched: each gets in a batch what it gets alone.
TEST_P(Matched, RoundsOfSearchAreEachPairsOwn) {
  const Relief scene = parallax(1);
  Relief rolled = scene;
  Vector6d xi;
  xi << 0.5, 0.2, 0.1, 0.02, 0.01, 0.5;
  rolled.T_10 = SE3::exp(xi);
  const Features features = random_features(scene, 120);
  const Frame image0 = render(scene, 0);
  const Frame targets[] = {render(scene, 1), render(rolled, 1), chequered(320, 240, 0, 1), render(scene, 1)};
  Plan plan = plan_of(scene);
  plan.max_pairs = 4;
  const auto together = make_aligner(way(), plan, matching());
  together->set_reference(0, {image0.view(), scene.camera, features, {}});
  std::vector<Pair> pairs;
  for (const Frame& target : targets) pairs.push_back({0, target.view(), {}, {}});
  const auto results = together->align(pairs);
  EXPECT_TRUE(results[0].converged()) << results[0].reason;
  EXPECT_TRUE(results[1].converged()) << results[1].reason;
  EXPECT_LT(pixel_error(rolled, features, results[1].T_10), 0.5);
  EXPECT_FALSE(results[2].converged());
  for (size_t i = 0; i < 4; ++i)
    EXPECT_TRUE(same_bits(results[i], align_once(way(), scene, image0, targets[i], features, matching()))) << i;
}

// Beside a pair that is searched for, one that begins where its guess says, and is none the less for repeated texture.
TEST_P(Matched, APairMayBeginAtItsGuess) {
  const Relief scene = parallax(1);
  const Features features = random_features(scene, 120);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1), wall0 = chequered(320, 240, 0, 1),
              wall1 = chequered(320, 240, 3, 2);
  Relief flat = scene;
  flat.depth_amplitude = 0;
  const Features on_wall = random_features(flat, 120);
  Plan plan = plan_of(scene);
  plan.max_references = 2, plan.max_pairs = 4;
  const auto aligner = make_aligner(way(), plan, matching());
  aligner->set_reference(0, {image0.view(), scene.camera, features, {}});
  aligner->set_reference(1, {wall0.view(), scene.camera, on_wall, {}});
  SE3 near = scene.T_10;
  near.t.x() += 0.02;
  const Pair pairs[] = {{0, image1.view(), {}, {}},
                        {0, image1.view(), near, {}, false},
                        {1, wall1.view(), {}, {}, false},
                        {1, wall1.view(), {}, {}}};
  const auto results = aligner->align(pairs);
  ASSERT_TRUE(results[0].converged()) << results[0].reason;
  EXPECT_TRUE(results[0].levels[0].iterations.empty()) << "matched";
  EXPECT_FALSE(results[1].levels[0].iterations.empty()) << "not matched: it begins at the coarsest level";
  EXPECT_TRUE(same_bits(results[1], [&] {
    AlignerOptions options = matching();
    options.search = false;
    return align_once(way(), scene, image0, image1, features, options, near);
  }()));
  EXPECT_TRUE(results[2].converged()) << results[2].reason;
  EXPECT_EQ(results[3].status, Status::degenerate) << results[3].reason;
}

TEST_P(Matched, WarmingUpChangesNothing) {
  const Relief scene = parallax(1);
  const Features features = random_features(scene, 120);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  const auto aligner = make_aligner(way(), plan_of(scene), matching());
  aligner->warm_up();
  aligner->set_reference(0, {image0.view(), scene.camera, features, {}});
  const Alignment cold = align_once(way(), scene, image0, image1, features, matching());
  EXPECT_TRUE(cold.converged()) << cold.reason;
  EXPECT_TRUE(same_bits(aligner->align({.target = image1.view()}), cold));
  aligner->warm_up();
  EXPECT_TRUE(same_bits(aligner->align({.target = image1.view()}), cold));
}

TEST_P(Matched, UnrelatedImagesAreNotClaimed) {
  for (uint32_t seed = 1; seed <= 6; ++seed) {
    const Relief scene = parallax(seed);
    Relief other = parallax(seed + 20);
    const Alignment a = align_once(way(), scene, render(scene, 0), render(other, 1), random_features(scene, 120), matching());
    EXPECT_FALSE(a.converged()) << seed << ": " << a.reason;
  }
}

// Wherever a feature is looked for there is another place like it: the nearest of many poses is no answer to be claimed, but
// one for somebody who says where to look.
TEST_P(Matched, RepeatedTextureIsSaid) {
  Relief scene;
  scene.camera = {300, 300, 159.5, 119.5, 320, 240};
  scene.depth_amplitude = 0;
  scene.T_10.t.x() = 3.0 * scene.distance / 300;
  const Features features = random_features(scene, 100);
  const Frame image0 = chequered(320, 240, 0, 1), image1 = chequered(320, 240, 3, 2);
  const Alignment a = align_once(way(), scene, image0, image1, features, matching());
  EXPECT_EQ(a.status, Status::degenerate) << a.reason;
  EXPECT_NE(a.reason.find("repeats: 100 %"), std::string::npos) << a.reason;
  EXPECT_TRUE(a.covariance.isZero());
  EXPECT_LT(a.T_10.t.norm(), 2 * scene.distance) << "nor is it started from far away";
  PosePrior prior{scene.T_10, Matrix6d::Identity() * 1e4};
  const Alignment b = align_once(way(), scene, image0, image1, features, matching(), scene.T_10, prior);
  EXPECT_TRUE(b.converged()) << b.reason;
  AlignerOptions near = matching();
  near.search = false;
  const Alignment c = align_once(way(), scene, image0, image1, features, near);
  EXPECT_TRUE(c.converged()) << c.reason;
  EXPECT_LT(pixel_error(scene, features, c.T_10), 0.1);
}

INSTANTIATE_TEST_SUITE_P(All, Matched, testing::Values(Way::cpu, Way::host, Way::device, Way::split), way_name);

// A start that matching found must not stay when the same commands see images that it cannot match.
TEST(MatchedRecording, ExecutedAgainBeginsAnew) {
  ICLK_NEED_DEVICE();
  Application app;
  const auto context = app.adopt();
  const Relief scene = parallax();
  DeviceAligner aligner(context, plan_of(scene), matching(), Solver::device);
  const Features features = random_features(scene, 120);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  const Frame flat{320, 240, std::vector<float>(320 * 240, 0.5f)};
  aligner.set_reference(0, {image0.view(), scene.camera, features, {}});
  ApplicationImage image(app, 320, 240, VK_FORMAT_R32_SFLOAT, VK_IMAGE_LAYOUT_GENERAL);
  const auto recording = aligner.make_recording();
  const ApplicationCommands host(app);
  const DevicePair pair{0, image.foreign, {}, {}};
  aligner.record(*recording, host.commands, {}, {&pair, 1});
  host.end();
  std::vector<Alignment> results;
  for (const Frame* frame : {&image1, &flat, &image0, &image1}) {
    image.fill(context, frame->data.data(), 4 * frame->data.size());
    host.submit_and_wait();
    results.push_back(recording->read().at(0));
  }
  EXPECT_TRUE(results[0].converged()) << results[0].reason;
  EXPECT_FALSE(results[1].converged());
  EXPECT_LT(results[1].T_10.log().norm(), 0.5) << "the guess, not what was found before";
  EXPECT_TRUE(results[0].levels.at(0).iterations.empty()) << "matched: it begins at a finer level";
  EXPECT_FALSE(results[1].levels.at(0).iterations.empty()) << "not matched: it begins at the coarsest";
  EXPECT_TRUE(results[2].converged()) << results[2].reason;
  EXPECT_LT(results[2].T_10.log().norm(), 1e-4);
  EXPECT_TRUE(same_bits(results[0], results[3]));
}

}  // namespace
}  // namespace iclk::test
