// One suite over every solver: known motions, options, priors.
#include <array>

#include "solvers.h"

namespace iclk::test {
namespace {

class Pose : public Solvers {};

TEST_P(Pose, AnImageAgainstItselfIsTheIdentity) {
  const Relief scene;
  const Frame image = render(scene, 0);
  const Features features = random_features(scene, 50);
  for (bool photometric : {false, true}) {
    AlignerOptions options;
    options.photometric = photometric;
    const Alignment a = align_once(way(), scene, image, image, features, options);
    EXPECT_EQ(a.status, Status::converged) << a.reason;
    EXPECT_LT(distance(a.T_10, {}, scene.distance), 1e-6);
    EXPECT_NEAR(a.gain, 1, 1e-5);
    EXPECT_NEAR(a.bias, 0, 1e-5);
    EXPECT_NEAR(a.correlation, 1, 1e-5);
    EXPECT_NEAR(a.cost, 0, 1e-9);
    EXPECT_EQ(a.visible_fraction, 1);
    ASSERT_EQ(a.levels.size(), 4u);
    for (const LevelTrace& level : a.levels) EXPECT_EQ(level.iterations.size(), 1u);
  }
}

// Every axis and sign: T_10 maps camera 0 to camera 1, X1 = T_10 X0.
TEST_P(Pose, KnownMotionsComeBackWithTheirSign) {
  Relief scene;
  const Features features = random_features(scene, 50);
  const Frame image0 = render(scene, 0);
  const auto aligner = make_aligner(way(), plan_for(scene.camera));
  aligner->set_reference(0, {image0.view(), scene.camera, features, {}});
  for (int axis = 0; axis < 6; ++axis)
    for (double sign : {-1.0, 1.0}) {
      Vector6d xi = Vector6d::Zero();
      xi(axis) = sign * std::array{0.1, 0.1, 0.2, 0.025, 0.025, 0.04}[static_cast<size_t>(axis)];  // about 3 px
      scene.T_10 = SE3::exp(xi);
      const Frame image1 = render(scene, 1);
      const Alignment a = aligner->align(Pair{0, image1.view(), {}, {}});
      EXPECT_EQ(a.status, Status::converged) << a.reason;
      const Vector6d found = a.T_10.log();
      EXPECT_LT((found - xi).norm(), 5e-4 + 0.025 * std::abs(xi(axis))) << "axis " << axis << ": " << found.transpose();
      EXPECT_LT(pixel_error(scene, features, a.T_10), 0.02) << "axis " << axis;
      EXPECT_GT(pixel_error(scene, features, {}), 1.5);
    }
}

// What the sign means in pixels: the camera moves by -t, points by +t.
TEST_P(Pose, PositiveTranslationMovesTheImageToTheRight) {
  Relief scene;
  scene.T_10.t.x() = 0.1;
  EXPECT_GT(scene.truth({80, 60}).x(), 82);
  const Features features = random_features(scene, 50);
  const Alignment a = align_once(way(), scene, render(scene, 0), render(scene, 1), features);
  EXPECT_NEAR(a.T_10.t.x(), 0.1, 0.002);
}

TEST_P(Pose, ANegativeFocalLengthIsLegal) {
  Relief scene;
  scene.camera.fy = -130;
  Vector6d xi;
  xi << 0.05, 0.08, -0.1, 0.01, -0.015, 0.02;
  scene.T_10 = SE3::exp(xi);
  const Features features = random_features(scene, 50);
  const Alignment a = align_once(way(), scene, render(scene, 0), render(scene, 1), features);
  EXPECT_EQ(a.status, Status::converged) << a.reason;
  EXPECT_LT((a.T_10.log() - xi).norm(), 2e-3) << a.T_10.log().transpose();
}

TEST_P(Pose, GainAndBiasComeBack) {
  Relief scene;
  scene.shortest = 16;  // bilinear interpolation damps finer texture, which a smaller gain would explain
  Vector6d xi;
  xi << 0.05, -0.06, 0.1, 0.01, 0.012, -0.02;
  scene.T_10 = SE3::exp(xi);
  scene.gain = 1.3;
  scene.bias = -0.1;
  const Features features = random_features(scene, 50);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  const Alignment a = align_once(way(), scene, image0, image1, features);
  EXPECT_EQ(a.status, Status::converged) << a.reason;
  EXPECT_NEAR(a.gain, 1.3, 5e-3);
  EXPECT_NEAR(a.bias, -0.1, 5e-3);
  EXPECT_LT(pixel_error(scene, features, a.T_10), 0.02);
  AlignerOptions options;
  options.photometric = false;
  const Alignment without = align_once(way(), scene, image0, image1, features, options);
  EXPECT_EQ(without.gain, 1);
  EXPECT_EQ(without.bias, 0);
  EXPECT_GT(pixel_error(scene, features, without.T_10), 0.05);  // what the estimate is good for
}

TEST_P(Pose, AnInitialPoseSavesTheWay) {
  Relief scene;
  Vector6d xi;
  xi << 0.6, -0.4, 0.3, 0.1, 0.15, -0.12;  // about 30 px: out of the basin
  scene.T_10 = SE3::exp(xi);
  const Features features = random_features(scene, 50, 2, 45);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  Vector6d off;
  off << 0.03, 0.02, -0.02, 0.004, -0.003, 0.005;
  const SE3 start = scene.T_10 * SE3::exp(off);
  AlignerOptions options;
  options.min_visible = 0.1;
  const Alignment a = align_once(way(), scene, image0, image1, features, options, start);
  EXPECT_EQ(a.status, Status::converged) << a.reason;
  EXPECT_LT(pixel_error(scene, features, a.T_10), 0.1);
}

TEST_P(Pose, OneToSevenLevels) {
  Relief scene;
  scene.camera = {208, 208, 127.5, 99.5, 256, 200};
  Vector6d xi;
  xi << 0.01, -0.012, 0.01, 0.002, 0.001, -0.003;  // under 1 px: one level is enough
  scene.T_10 = SE3::exp(xi);
  const Features features = random_features(scene, 40);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  for (int levels : {1, 2, 3, 5, 7}) {
    AlignerOptions options;
    options.levels = levels;
    options.damping = levels > 5 ? Damping::adaptive : Damping::fixed;  // 4x3 pixels throw an undamped step far away
    const Alignment a = align_once(way(), scene, image0, image1, features, options);
    EXPECT_EQ(a.status, Status::converged) << levels << ": " << a.reason;
    ASSERT_EQ(a.levels.size(), static_cast<size_t>(levels));
    for (int i = 0; i < levels; ++i) EXPECT_EQ(a.levels[static_cast<size_t>(i)].level, levels - 1 - i);
    EXPECT_LT(pixel_error(scene, features, a.T_10), 0.02) << levels;
  }
}

TEST_P(Pose, ZeroToleranceTakesEveryIteration) {
  Relief scene;
  scene.T_10.t.x() = 0.05;
  const Features features = random_features(scene, 50);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  AlignerOptions options;
  options.step_tolerance = 0;
  const Alignment a = align_once(way(), scene, image0, image1, features, options);
  ASSERT_EQ(a.levels.size(), 4u);
  for (const LevelTrace& level : a.levels) EXPECT_EQ(level.iterations.size(), 10u);
  EXPECT_EQ(a.status, Status::converged) << a.reason;
  options.iterations = 3;
  for (const LevelTrace& level : align_once(way(), scene, image0, image1, features, options).levels)
    EXPECT_EQ(level.iterations.size(), 3u);
}

TEST_P(Pose, APriorPullsByItsInformation) {
  const Relief scene = moved_relief();
  const Features features = random_features(scene, 50);
  const Frame image0 = render(scene, 0), image1 = render(scene, 1);
  Vector6d elsewhere;
  elsewhere << -0.02, 0.03, 0.01, 0.004, -0.006, 0.01;
  PosePrior prior{SE3::exp(elsewhere), Matrix6d::Zero()};
  for (Damping damping : {Damping::fixed, Damping::adaptive}) {
    AlignerOptions options;
    options.robust = Robust::unit;  // half way only if a prior does not change the weights
    options.damping = damping;
    const Alignment free = align_once(way(), scene, image0, image1, features, options);
    prior.information.setZero();
    const Alignment none = align_once(way(), scene, image0, image1, features, options, {}, prior);
    EXPECT_LT(distance(none.T_10, free.T_10, scene.distance), 1e-6) << "zero information";
    prior.information = 1e13 * Matrix6d::Identity();
    const Alignment held = align_once(way(), scene, image0, image1, features, options, {}, prior);
    EXPECT_LT(distance(held.T_10, prior.T_10, 1), 1e-4) << "huge information";
    // As much information as the images have, H / residual_sigma^2, half a pixel away: half way.
    Vector6d away;
    away << 0.005, -0.004, 0.01, 0.001, 0.002, -0.003;
    const PosePrior near{free.T_10 * SE3::exp(away), free.H / (options.residual_sigma * options.residual_sigma)};
    const Alignment half = align_once(way(), scene, image0, image1, features, options, {}, near);
    EXPECT_LT(((free.T_10.inverse() * half.T_10).log() - 0.5 * away).norm(), 0.1 * away.norm()) << static_cast<int>(damping);
    // A far prior, where the coupling of rotation and translation in its derivative counts: every solver ends at the same
    // compromise.
    Vector6d far;
    far << 0.8, -0.6, 0.5, 0.3, -0.25, 0.35;
    Matrix6d information = 2000 * Matrix6d::Identity();
    for (int i = 0; i < 6; ++i) information(i, i) *= 1 + i;
    information(0, 4) = information(4, 0) = 1000;
    const PosePrior weak{SE3::exp(far), information};
    const Alignment compromise = align_once(way(), scene, image0, image1, features, options, {}, weak);
    EXPECT_GT(distance(compromise.T_10, free.T_10, scene.distance), 1e-3);
    if (way() != Way::cpu) {
      const Alignment expected = align_once(Way::cpu, scene, image0, image1, features, options, {}, weak);
      EXPECT_LT(distance(compromise.T_10, expected.T_10, scene.distance), 1e-5);
      EXPECT_EQ(compromise.status, expected.status);
    }
    // Only one direction is held: x of the translation.
    prior.information.setZero();
    prior.information(0, 0) = 1e13;
    const Alignment one = align_once(way(), scene, image0, image1, features, options, {}, prior);
    EXPECT_LT(std::abs((prior.T_10.inverse() * one.T_10).log()(0)), 1e-4);
    EXPECT_GT(distance(one.T_10, prior.T_10, 1), 1e-2);
  }
}

INSTANTIATE_TEST_SUITE_P(All, Pose, testing::Values(Way::cpu, Way::host, Way::device, Way::split), way_name);

struct Combination {
  Robust robust;
  Damping damping;
  bool photometric;
};

std::string text(const Combination& c) {
  constexpr const char* robust[] = {"unit", "huber", "tukey", "cauchy"};
  return std::string(robust[static_cast<int>(c.robust)]) + (c.damping == Damping::fixed ? "_fixed" : "_adaptive") +
         (c.photometric ? "_photometric" : "");
}
void PrintTo(const Combination& c, std::ostream* out) { *out << text(c); }

class Agreement : public testing::TestWithParam<Combination> {};

// The same pose, status, covariance, iterations and robust scales from every solver.
TEST_P(Agreement, OfAllSolvers) {
  ICLK_NEED_DEVICE();
  Relief scene;
  scene.noise = 0.01;
  Vector6d xi;
  xi << 0.06, -0.05, 0.12, 0.012, 0.015, -0.03;
  scene.T_10 = SE3::exp(xi);
  if (GetParam().photometric) scene.gain = 1.2, scene.bias = -0.05;
  const Features features = random_features(scene, 50);
  const Frame image0 = render(scene, 0);
  Frame image1 = render(scene, 1);
  for (int v = 40; v < 70; ++v)  // a foreign object, which robust weights leave out
    for (int u = 60; u < 85; ++u) image1.at(u, v) = 0.9f;
  AlignerOptions options;
  options.robust = GetParam().robust;
  options.damping = GetParam().damping;
  options.photometric = GetParam().photometric;
  const Alignment expected = align_once(Way::cpu, scene, image0, image1, features, options);
  if (options.robust != Robust::unit) {
    EXPECT_LT(pixel_error(scene, features, expected.T_10), 0.3);
  }
  Vector6d motion = expected.T_10.log();
  motion.head<3>() /= scene.distance;
  for (Way way : {Way::host, Way::device, Way::split}) {
    SCOPED_TRACE(name(way));
    const Alignment a = align_once(way, scene, image0, image1, features, options);
    EXPECT_EQ(a.status, expected.status) << a.reason;
    const double off = distance(a.T_10, expected.T_10, scene.distance) / motion.norm();
    EXPECT_LT(off, 1e-4);
    RecordProperty(std::string("difference_") + name(way), std::to_string(off));
    EXPECT_NEAR(a.gain, expected.gain, 1e-4);
    EXPECT_NEAR(a.bias, expected.bias, 1e-4);
    EXPECT_NEAR(a.cost, expected.cost, 1e-3 * expected.cost);
    EXPECT_NEAR(a.correlation, expected.correlation, 1e-4);
    EXPECT_NEAR(a.visible_fraction, expected.visible_fraction, 2e-3);
    EXPECT_LT((a.H - expected.H).norm(), 1e-3 * expected.H.norm());
    EXPECT_LT((a.covariance - expected.covariance).norm(), 1e-2 * expected.covariance.norm());
    EXPECT_NEAR(a.agreement, expected.agreement, 2e-3);
    EXPECT_GT(a.agreement, 0.5);
    ASSERT_EQ(a.levels.size(), expected.levels.size());
    for (size_t l = 0; l < a.levels.size(); ++l) {
      EXPECT_NEAR(a.levels[l].scale, expected.levels[l].scale, 1e-3 * expected.levels[l].scale);
      const auto &got = a.levels[l].iterations, &want = expected.levels[l].iterations;
      EXPECT_EQ(got.size(), want.size()) << "level " << a.levels[l].level;
      for (size_t i = 0; i < std::min(got.size(), want.size()); ++i) {
        EXPECT_EQ(got[i].accepted, want[i].accepted);
        EXPECT_NEAR(got[i].cost, want[i].cost, 2e-3 * want[i].cost);
        EXPECT_NEAR(got[i].step, want[i].step, 2e-3 + 2e-3 * want[i].step);
        EXPECT_LT(distance(got[i].T_10, want[i].T_10, scene.distance), 1e-3 * motion.norm());
      }
    }
  }
}

std::vector<Combination> combinations() {
  std::vector<Combination> all;
  for (Robust robust : {Robust::unit, Robust::huber, Robust::tukey, Robust::cauchy})
    for (Damping damping : {Damping::fixed, Damping::adaptive})
      for (bool photometric : {false, true}) all.push_back({robust, damping, photometric});
  return all;
}

INSTANTIATE_TEST_SUITE_P(All, Agreement, testing::ValuesIn(combinations()), [](const auto& info) { return text(info.param); });

}  // namespace
}  // namespace iclk::test
