// Keyframes, batches and repetition: the same bits whichever way a pair is grouped.
#include <array>
#include <limits>

#include <Eigen/Dense>

#include "solvers.h"

namespace iclk::test {
namespace {

class Batch : public Solvers {
 protected:
  /// A pair of its own texture and motion.
  struct Case {
    Relief scene;
    Features features;
    Frame image0, image1;
  };
  static Case make(uint32_t seed, uint32_t texture) {
    Case c;
    c.scene.seed = texture;
    const double s = 0.01 * (1 + seed % 3);
    Vector6d xi;
    xi << 3 * s, -2 * s, 4 * s, 0.5 * s, -0.4 * s, s;
    if (seed % 2) xi = -xi;
    c.scene.T_10 = SE3::exp(xi);
    c.scene.gain = 1 + 0.05 * seed;
    c.features = random_features(c.scene, 30 + static_cast<int>(seed), texture);
    c.image0 = render(c.scene, 0);
    c.image1 = render(c.scene, 1);
    return c;
  }
  static std::vector<Case> make_all(int n, bool one_texture) {
    std::vector<Case> all;
    for (int i = 0; i < n; ++i) all.push_back(make(static_cast<uint32_t>(i), one_texture ? 1u : static_cast<uint32_t>(i + 1)));
    if (one_texture)
      for (Case& c : all) c.features = all[0].features;
    return all;
  }
  std::unique_ptr<Aligner> aligner(int references, int pairs, const AlignerOptions& options = {}) const {
    Plan plan = plan_for({1, 1, 0, 0, 160, 120});
    plan.max_references = references;
    plan.max_pairs = pairs;
    return make_aligner(way(), plan, options);
  }
  static Alignment single(Aligner& fresh, const Case& c) {
    fresh.set_reference(0, {c.image0.view(), c.scene.camera, c.features, {}});
    return fresh.align(Pair{0, c.image1.view(), {}, {}});
  }
};

TEST_P(Batch, AKeyframeServesManyTargets) {
  const auto cases = make_all(5, true);
  const auto kept = aligner(1, 1);
  kept->set_reference(0, {cases[0].image0.view(), cases[0].scene.camera, cases[0].features, {}});
  for (const Case& c : cases) {
    const Alignment a = kept->align(Pair{0, c.image1.view(), {}, {}});
    EXPECT_TRUE(a.converged()) << a.reason;
    EXPECT_LT(pixel_error(c.scene, c.features, a.T_10), 0.05);
    EXPECT_TRUE(same_bits(a, single(*aligner(1, 1), c)));
  }
}

TEST_P(Batch, IsTheSinglesBitByBit) {
  AlignerOptions options;
  options.robust = Robust::huber;
  const auto cases = make_all(5, false);
  std::vector<Alignment> expected;
  for (const Case& c : cases) {
    expected.push_back(single(*aligner(1, 1, options), c));
    EXPECT_TRUE(expected.back().converged()) << expected.back().reason;
    EXPECT_LT(pixel_error(c.scene, c.features, expected.back().T_10), 0.05);
  }
  for (int max_pairs : {5, 2, 1}) {  // 2 and 1: the span is split
    const auto batch = aligner(5, max_pairs, options);
    std::vector<Pair> pairs;
    for (size_t i = 0; i < cases.size(); ++i) {  // slots in another order than pairs
      const int slot = static_cast<int>((2 * i + 1) % 5);
      batch->set_reference(slot, {cases[i].image0.view(), cases[i].scene.camera, cases[i].features, {}});
      pairs.push_back({slot, cases[i].image1.view(), {}, {}});
    }
    for (int run = 0; run < 2; ++run) {
      const auto results = batch->align(pairs);
      ASSERT_EQ(results.size(), cases.size());
      for (size_t i = 0; i < cases.size(); ++i)
        EXPECT_TRUE(same_bits(results[i], expected[i])) << "pair " << i << " of batches of " << max_pairs << ", run " << run;
    }
  }
  EXPECT_TRUE(aligner(1, 1)->align(std::span<const Pair>{}).empty());
}

// What an aligner did before leaves no trace, whatever it was.
TEST_P(Batch, EarlierAlignmentsLeaveNoTrace) {
  for (Damping damping : {Damping::fixed, Damping::adaptive}) {
    AlignerOptions options;
    options.damping = damping;
    const Case c = make(1, 1), other = make(2, 2);
    const Alignment expected = single(*aligner(1, 1, options), c);
    const auto used = aligner(1, 1, options);
    single(*used, other);
    EXPECT_TRUE(same_bits(single(*used, c), expected));
    Frame flat = c.image0;  // leaves a state that is done and singular
    std::fill(flat.data.begin(), flat.data.end(), 0.5f);
    used->set_reference(0, {flat.view(), c.scene.camera, c.features, {}});
    EXPECT_EQ(used->align(Pair{0, flat.view(), {}, {}}).status, Status::degenerate);
    EXPECT_TRUE(same_bits(single(*used, c), expected));
    EXPECT_TRUE(same_bits(single(*used, c), expected));
  }
}

// Gain and bias of targets, a slot set anew, fewer features than before.
TEST_P(Batch, ASlotCanBeSetAnew) {
  const Case c = make(1, 1), other = make(4, 2);
  const auto kept = aligner(1, 1);
  single(*kept, other);
  Case fewer = c;
  fewer.features.uv.resize(12);
  fewer.features.inverse_depth.resize(12);
  EXPECT_TRUE(same_bits(single(*kept, fewer), single(*aligner(1, 1), fewer)));
  EXPECT_EQ(kept->features(0).size(), 12);
  EXPECT_EQ(kept->checks(0).size(), 12u);
}

INSTANTIATE_TEST_SUITE_P(All, Batch, testing::Values(Way::cpu, Way::host, Way::device, Way::split), way_name);

class Overlap : public Solvers {};

// Points leave the image on each side: less is seen, nothing crashes, and beyond the limit the status says so.
TEST_P(Overlap, PointsLeaveOnAllFourSides) {
  Relief scene;
  const Features features = random_features(scene, 50, 1, 5);
  const Frame image0 = render(scene, 0);
  const auto aligner = make_aligner(way(), plan_for(scene.camera));
  aligner->set_reference(0, {image0.view(), scene.camera, features, {}});
  for (int axis : {0, 1})
    for (double sign : {-1.0, 1.0}) {
      double last = 1;
      for (double share : {0.1, 0.5, 0.85}) {
        Relief moved = scene;
        const double size = axis == 0 ? scene.camera.width : scene.camera.height;
        moved.T_10.t(axis) = sign * share * size * scene.distance / scene.camera.fx;
        const Frame image1 = render(moved, 1);
        // Held at the truth, so that the overlap is known; then free.
        const PosePrior hold{moved.T_10, 1e13 * Matrix6d::Identity()};
        const Alignment a = aligner->align(Pair{0, image1.view(), moved.T_10, hold});
        SCOPED_TRACE("axis " + std::to_string(axis) + ", " + std::to_string(sign * share) + ": " + a.reason);
        EXPECT_LT(pixel_error(moved, features, a.T_10), 0.1);
        EXPECT_LT(a.visible_fraction, last);
        EXPECT_NEAR(a.visible_fraction, 1 - share, 0.2);
        last = a.visible_fraction;
        if (share < 0.6) {
          EXPECT_TRUE(a.converged() || a.status == Status::degenerate);  // what is left may not determine the pose
        } else {
          EXPECT_EQ(a.status, Status::low_overlap);
          EXPECT_NE(a.reason.find("30 % needed"), std::string::npos);
          EXPECT_EQ(a.covariance, Matrix6d::Zero());
        }
        for (const SE3& start : {moved.T_10, SE3{}}) {
          const Alignment free = aligner->align(Pair{0, image1.view(), start, {}});
          EXPECT_TRUE(free.T_10.matrix().allFinite() && free.H.allFinite() && std::isfinite(free.cost));
          EXPECT_TRUE(!free.converged() || pixel_error(moved, features, free.T_10) < 3) << free.reason;
        }
      }
      // Nothing is left at all, and a camera that looks away.
      SE3 away;
      away.t(axis) = sign * 100;
      const Alignment none = aligner->align(Pair{0, image0.view(), away, {}});
      EXPECT_EQ(none.status, Status::low_overlap) << none.reason;
      EXPECT_TRUE(none.T_10.matrix().allFinite());
      Vector6d turn = Vector6d::Zero();
      turn(3 + axis) = sign * 3;
      const Alignment behind = aligner->align(Pair{0, image0.view(), SE3::exp(turn), {}});
      EXPECT_EQ(behind.status, Status::low_overlap) << behind.reason;
      EXPECT_EQ(behind.visible_fraction, 0);
    }
}

INSTANTIATE_TEST_SUITE_P(All, Overlap, testing::Values(Way::cpu, Way::host, Way::device, Way::split), way_name);

class Dense : public Solvers {
 protected:
  static Alignment align(Way way, const Relief& scene, const Frame& image0, const Frame& image1, const Frame& q,
                         const AlignerOptions& options) {
    Plan plan = plan_for(scene.camera);
    plan.dense = true;
    const auto aligner = make_aligner(way, plan, options);
    aligner->set_reference(0, {image0.view(), scene.camera, {}, q.view()});
    return aligner->align(Pair{0, image1.view(), {}, {}});
  }
};

// 240x160 pixels are more than one workgroup serves (normal_equations.comp and lm_step.comp), 120x96 are fewer.
TEST_P(Dense, RecoversThePose) {
  for (const Camera& camera : {Camera{100, 100, 59.5, 47.5, 120, 96}, Camera{200, -200, 119.5, 79.5, 240, 160}}) {
    Relief scene;
    scene.camera = camera;
    Vector6d xi;
    xi << 0.06, -0.05, 0.12, 0.012, 0.015, -0.03;
    scene.T_10 = SE3::exp(xi);
    scene.gain = 1.1;
    const Features where = random_features(scene, 50);
    const Frame image0 = render(scene, 0), image1 = render(scene, 1);
    Frame q = inverse_depth_frame(scene);
    const float holes[] = {0, std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(), -1};
    for (bool broken : {false, true}) {
      if (broken)
        for (int i = 0; i < 4; ++i)
          for (int v = 5; v + i < camera.height; v += 11)
            for (int u = 3 + 20 * i; u < 15 + 20 * i; ++u) q.at(u, v + i) = holes[i];
      AlignerOptions options;
      if (broken) options.robust = Robust::cauchy;
      const Alignment a = align(way(), scene, image0, image1, q, options);
      EXPECT_TRUE(a.converged()) << a.reason;
      EXPECT_LT(pixel_error(scene, where, a.T_10), 0.05);
      EXPECT_NEAR(a.gain, 1.1, 0.02);
      EXPECT_TRUE(a.features.empty());
      const Alignment expected = way() == Way::cpu ? a : align(Way::cpu, scene, image0, image1, q, options);
      EXPECT_LT(distance(a.T_10, expected.T_10, scene.distance), 1e-5);
      EXPECT_NEAR(a.visible_fraction, expected.visible_fraction, 1e-3);
      EXPECT_LT((a.H - expected.H).norm(), 1e-3 * expected.H.norm());
    }
  }
}

TEST_P(Dense, WithoutAnyDepthThereAreTooFewFeatures) {
  const Relief scene;
  const Frame image = render(scene, 0);
  Frame q = inverse_depth_frame(scene);
  std::fill(q.data.begin(), q.data.end(), std::numeric_limits<float>::quiet_NaN());
  const Alignment a = align(way(), scene, image, image, q, {});
  EXPECT_EQ(a.status, Status::too_few_features) << a.reason;
}

INSTANTIATE_TEST_SUITE_P(All, Dense, testing::Values(Way::cpu, Way::host, Way::device), way_name);

// Noise of the same size, averaged over boxes.
template <class Draw>
void add_noise(Frame& image, int blur, Draw&& draw) {
  Frame noise = image;
  for (float& value : noise.data) value = draw();
  const auto at = [&](int u, int v) {  // around the border
    const int row = (v + image.height) % image.height, column = (u + image.width) % image.width;
    return noise.data[static_cast<size_t>(row * image.width + column)];
  };
  for (int v = 0; v < image.height; ++v)
    for (int u = 0; u < image.width; ++u) {
      float sum = 0;
      for (int y = -blur; y <= blur; ++y)
        for (int x = -blur; x <= blur; ++x) sum += at(u + x, v + y);
      image.data[static_cast<size_t>(v * image.width + u)] += sum / static_cast<float>(2 * blur + 1);
    }
}

// Noise on both images: the squared error of the pose, measured in the covariance that is stated for it, is 6 in the mean (chi
// square of 6 degrees of freedom) where the covariance is exact. So it is between pixel-aligned images; in general motion it is
// a little more, because interpolation makes residuals smaller than the noise that moves the pose. The plain s^2 H^-1, which
// takes the template's noise for texture, gives 6.2 and 11.8 here. Noise that neighbours share must count as that of fewer
// pixels: without Agreement::variance_ratio() the last setting has 34.
TEST(Covariance, MatchesTheErrorOfManyNoisyPairs) {
  Relief scene;
  scene.shortest = 12;  // the error of interpolating finer texture is no noise
  const Features features = random_features(scene, 50);
  AlignerOptions options;
  options.levels = 1;
  const auto aligner = make_aligner(Way::cpu, plan_for(scene.camera), options);
  Vector6d moved;
  moved << 0.02, -0.03, 0.04, 0.004, 0.005, -0.01;
  struct Setting {
    Vector6d xi;
    double noise;
    int blur;  // half width of the box over which noise is averaged
    double least, most;
  };
  const Vector6d still = Vector6d::Zero();
  for (const auto& [xi, noise, blur, least, most] :
       {Setting{still, 0.005, 0, 5, 7}, Setting{moved, 0.02, 0, 5, 9.5}, Setting{still, 0.005, 1, 5, 9}}) {
    scene.T_10 = SE3::exp(xi);
    const Frame exact0 = render(scene, 0), exact1 = render(scene, 1);
    std::mt19937 random(3);
    std::normal_distribution<float> normal(0, static_cast<float>(noise));
    double sum = 0;
    constexpr int runs = 300;
    for (int i = 0; i < runs; ++i) {
      Frame image0 = exact0, image1 = exact1;
      for (Frame* image : {&image0, &image1}) add_noise(*image, blur, [&] { return normal(random); });
      aligner->set_reference(0, {image0.view(), scene.camera, features, {}});
      const Alignment a = aligner->align(Pair{0, image1.view(), scene.T_10, {}});
      ASSERT_TRUE(a.converged()) << a.reason;
      EXPECT_LT((a.H - a.H.transpose()).norm(), 1e-9 * a.H.norm());
      EXPECT_LT((a.covariance - a.covariance.transpose()).norm(), 1e-9 * a.covariance.norm());
      ASSERT_GT(Eigen::SelfAdjointEigenSolver<Matrix6d>(a.H).eigenvalues()(0), 0);
      ASSERT_GT(Eigen::SelfAdjointEigenSolver<Matrix6d>(a.covariance).eigenvalues()(0), 0);
      const Vector6d e = (a.T_10.inverse() * scene.T_10).log();  // truth = mean Exp(e)
      sum += e.dot(a.covariance.ldlt().solve(e));
    }
    RecordProperty("nees_" + std::to_string(noise), std::to_string(sum / runs));
    std::printf("  noise %.3f: mean normalised squared error of %d pairs %.2f (6 is exact)\n", noise, runs, sum / runs);
    EXPECT_GT(sum / runs, least);
    EXPECT_LT(sum / runs, most);
  }
}

}  // namespace
}  // namespace iclk::test
