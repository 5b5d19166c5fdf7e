#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>

#include <gtest/gtest.h>
#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/engine/error.h>
#include <iclk/refine/internal/feature_aligner.h>
#include <iclk/refine/refiner.h>
#include <Eigen/Cholesky>

#include "../support/synthetic.h"

namespace iclk {
namespace {

using test::Picture;
using test::Scene;

Scene small_scene() {
  Scene scene;
  scene.camera = {225.6, 225.6, 187.5, 119.5, 376, 240};
  Vector6d xi;
  xi << 1.2, -0.8, 0.9, 0.006, -0.009, 0.03;
  scene.T_10 = SE3::exp(xi);
  scene.gain = 1.2;
  scene.bias = -0.08;
  scene.noise = 0.005;
  return scene;
}

/// An aligner that calls any pose converged: the refiner must not believe it.
class Overconfident final : public Aligner {
 public:
  explicit Overconfident(CpuAligner& aligner, const SE3& pose) : aligner_(aligner), pose_(pose) {}
  std::vector<FeatureCheck> set_reference(int slot, const Reference& reference) override {
    return aligner_.set_reference(slot, reference);
  }
  std::vector<Alignment> align(std::span<const Pair> pairs) override {
    std::vector<Alignment> results = aligner_.align(pairs);
    for (Alignment& r : results) {
      r.T_10 = pose_;
      r.status = Status::converged;
    }
    return results;
  }
  const Camera& camera(int slot) const override { return aligner_.camera(slot); }
  const Features& features(int slot) const override { return aligner_.features(slot); }
  const std::vector<FeatureCheck>& checks(int slot) const override { return aligner_.checks(slot); }
  const Plan& plan() const override { return aligner_.plan(); }

 private:
  CpuAligner& aligner_;
  SE3 pose_;
};

/// Finds no feature, as on grey values that have nothing in common.
class Blind final : public internal::FeatureAligner {
 public:
  explicit Blind(std::unique_ptr<internal::FeatureAligner> eyes) : eyes_(std::move(eyes)) {}
  std::vector<internal::AlignedFeatures> align(std::span<const internal::FeatureAlignmentTask> tasks) override {
    auto found = eyes_->align(tasks);
    for (internal::AlignedFeatures& aligned : found)
      for (AlignedFeature& f : aligned.features) f.status = FeatureStatus::diverged;
    return found;
  }
  int pairs_per_batch() const override { return eyes_->pairs_per_batch(); }

 private:
  std::unique_ptr<internal::FeatureAligner> eyes_;
};

struct Fixture : ::testing::Test {
  Scene scene = small_scene();
  Picture I0 = test::render(scene, 0, 1), I1 = test::render(scene, 1, 1);
  Features features = test::random_features(scene, 50, 4);
  std::unique_ptr<CpuAligner> aligner;

  void SetUp() override {
    Plan plan;
    plan.width = scene.camera.width;
    plan.height = scene.camera.height;
    plan.max_features = std::max(features.size(), 50);
    plan.max_pairs = 2;
    plan.format = PixelFormat::r32f;
    aligner = std::make_unique<CpuAligner>(plan, AlignerOptions{});
    set_reference();
  }
  void set_reference() {
    Reference reference;
    reference.image = I0.view();
    reference.camera = scene.camera;
    reference.features = features;
    aligner->set_reference(0, reference);
  }
  Pair pair() const {
    Pair p;
    p.target = I1.view();
    return p;
  }
  RefinedAlignment claim(const SE3& T_10, const RefinerOptions& options = {}) {
    Overconfident overconfident(*aligner, T_10);
    Refiner refiner(overconfident, internal::make_feature_aligner(*aligner, options.feature_alignment), options);
    return refiner.align(pair());
  }
  /// Mean distance of the projected features from the truth, px.
  double error(const SE3& T_10) const {
    double sum = 0;
    for (int i = 0; i < features.size(); ++i) {
      const Eigen::Vector3d X0 = scene.camera.ray(features.uv[i]) / features.inverse_depth[i];
      sum += (scene.camera.project(T_10 * X0) - scene.camera.project(scene.T_10 * X0)).norm() / features.size();
    }
    return sum;
  }
  SE3 off_by(double px) const {
    Vector6d xi = Vector6d::Zero();
    xi[4] = px / scene.camera.fx;
    return scene.T_10 * SE3::exp(xi);
  }
};

using Refine = Fixture;

TEST_F(Refine, ConvergesCloserThanIclk) {
  RefinerOptions options;
  options.structure = true;
  Refiner refiner(*aligner, options);
  const RefinedAlignment r = refiner.align(pair());
  ASSERT_EQ(r.status, Status::converged) << r.reason;
  EXPECT_LT(error(r.T_10), 0.03);
  EXPECT_LE(error(r.T_10), error(r.iclk.T_10) + 0.01);
  ASSERT_EQ(r.stages.size(), 5u);
  const char* names[] = {"iclk", "feature_alignment", "pose", "structure", "rivals"};
  for (int i = 0; i < 5; ++i) {
    EXPECT_EQ(r.stages[i].name, names[i]);
    EXPECT_GT(r.stages[i].ms, 0);
    EXPECT_GE(r.stages[i].cost, 0);
  }
  EXPECT_LE(r.stages[2].cost, r.stages[1].cost);
  EXPECT_EQ(r.stages[3].T_10.matrix(), r.T_10.matrix());
  EXPECT_GT(r.covariance.diagonal().minCoeff(), 0);
  EXPECT_EQ(r.features.size(), 50u);
  EXPECT_EQ(r.inverse_depth.size(), 50u);
  EXPECT_EQ(r.inverse_depth_sigma.size(), 50u);
  EXPECT_GE(r.aligned, 45);
  EXPECT_GE(r.inliers, 45);
}

TEST_F(Refine, RoundsBringAFarStartHome) {
  // Rolled by 0.04: only features near the axis are within the 3 px that a round can correct; the pose from them warps the
  // others.
  Vector6d roll = Vector6d::Zero();
  roll[5] = 0.04;
  const SE3 start = scene.T_10 * SE3::exp(roll);
  RefinerOptions options;
  options.feature_alignment.max_motion = 3;
  options.rounds = 1;
  const RefinedAlignment one = claim(start, options);
  options.rounds = 4;
  const RefinedAlignment four = claim(start, options);
  ASSERT_TRUE(four.converged()) << four.reason;
  EXPECT_GT(error(start), 3);
  EXPECT_LT(error(four.T_10), 0.05);
  EXPECT_GT(error(one.stages.back().T_10), 2 * error(four.T_10));
  EXPECT_GT(four.rounds, 1);
  EXPECT_GT(four.aligned, one.aligned + 10);
}

TEST_F(Refine, RoundsEndWhenNothingMoves) {
  RefinerOptions options;
  options.rounds = 20;
  EXPECT_LT(claim(scene.T_10, options).rounds, 6);
}

TEST_F(Refine, AWrongPoseIsNeverCalledConverged) {
  int wrong = 0;
  for (double px : {15.0, -20.0, 30.0, 45.0, -60.0, 90.0})
    for (double roll : {0.0, 0.15, -0.3}) {
      Vector6d xi = Vector6d::Zero();
      xi[5] = roll;
      const SE3 T = off_by(px) * SE3::exp(xi);
      const RefinedAlignment r = claim(T);
      if (r.converged() && error(r.T_10) > 1) ++wrong;
      if (!r.converged()) {
        EXPECT_FALSE(r.reason.empty());
        EXPECT_EQ(r.covariance, Matrix6d::Zero());
        EXPECT_EQ(r.T_10.matrix(), T.matrix());  // no better pose is known
      }
    }
  EXPECT_EQ(wrong, 0);
}

TEST_F(Refine, AnUnrelatedTargetIsNotConverged) {
  Scene other = scene;
  for (uint32_t seed = 50; seed < 60; ++seed) {
    other.seed = seed;
    I1 = test::render(other, 1, 1);
    EXPECT_FALSE(Refiner(*aligner).align(pair()).converged()) << seed;
    EXPECT_FALSE(claim(scene.T_10).converged()) << seed;
  }
}

TEST_F(Refine, ACorrectionBeyondTheLimitIsNotBelieved) {
  RefinerOptions options;
  options.max_correction = 2;
  options.keep_unconfirmed = true;  // nor is the pose that it speaks against
  const RefinedAlignment r = claim(off_by(4), options);
  EXPECT_EQ(r.status, Status::diverged);
  EXPECT_NE(r.reason.find("more than the 2 px"), std::string::npos) << r.reason;
}

struct NoisyRefine : Refine {
  RefinerOptions options;
  void SetUp() override {
    scene.noise = 0.15;
    I0 = test::render(scene, 0, 1);
    I1 = test::render(scene, 1, 2);
    features = test::random_features(scene, 150, 10);
    options.keep_unconfirmed = true;
    Refine::SetUp();
  }
};

TEST_F(NoisyRefine, FeaturesOfHalfTheSizeFindAModelsPoseAgain) {
  const RefinedAlignment r = claim(off_by(1.2), options);
  ASSERT_TRUE(r.converged() && r.refined) << r.reason;
  EXPECT_TRUE(r.found_again);
  EXPECT_NE(r.reason.find("features found at half the size"), std::string::npos) << r.reason;
  EXPECT_LT(error(r.T_10), 0.25);
  EXPECT_GT(r.covariance.trace(), 0);
  EXPECT_EQ(r.features.size(), 150u);
  options.keep_unconfirmed = false;
  EXPECT_FALSE(claim(off_by(1.2), options).converged()) << "the classical mode's pose is no other evidence";
}

TEST_F(NoisyRefine, FeaturesOfHalfTheSizeDoNotReplaceAPoseFarFromTheirs) {
  for (const double px : {3.0, -5.0}) {
    const RefinedAlignment r = claim(off_by(px), options);
    EXPECT_FALSE(r.refined) << r.reason;
    EXPECT_EQ(r.T_10.matrix(), off_by(px).matrix());
  }
}

/// Remembers the levels on which no motion was tried.
class Watched final : public internal::FeatureAligner {
 public:
  Watched(std::unique_ptr<internal::FeatureAligner> eyes, std::vector<int>& levels) : eyes_(std::move(eyes)), levels_(levels) {}
  std::vector<internal::AlignedFeatures> align(std::span<const internal::FeatureAlignmentTask> tasks) override {
    for (const internal::FeatureAlignmentTask& task : tasks)
      if (task.T_10.matrix().isIdentity(1e-12)) levels_.push_back(task.level);
    return eyes_->align(tasks);
  }
  int pairs_per_batch() const override { return eyes_->pairs_per_batch(); }

 private:
  std::unique_ptr<internal::FeatureAligner> eyes_;
  std::vector<int>& levels_;
};

TEST_F(NoisyRefine, RivalsOfAPoseFromHalfTheSizeAreAlignedThere) {
  Overconfident overconfident(*aligner, off_by(1.2));
  std::vector<int> levels;
  Pair found = pair();
  found.found = true;  // no motion is a rival then
  auto eyes = std::make_unique<Watched>(internal::make_feature_aligner(*aligner, {}), levels);
  const RefinedAlignment r = Refiner(overconfident, std::move(eyes), options).align(found);
  EXPECT_TRUE(r.refined) << r.reason;
  EXPECT_EQ(levels, std::vector<int>{1});
}

TEST_F(NoisyRefine, APairWithAFirstGuessIsNotLookedAtAgain) {
  Overconfident overconfident(*aligner, off_by(1.2));
  Pair guessed = pair();
  guessed.search = false;
  const RefinedAlignment r = Refiner(overconfident, internal::make_feature_aligner(*aligner, {}), options).align(guessed);
  EXPECT_FALSE(r.refined) << r.reason;
}

TEST_F(Refine, FindingTheSamePoseCountsForModelsAlone) {
  RefinerOptions options;
  EXPECT_FALSE(Refiner(*aligner, options).align(pair()).found_again);
  options.keep_unconfirmed = true;  // as with a model
  EXPECT_TRUE(Refiner(*aligner, options).align(pair()).found_again);
}

TEST_F(Refine, WhereNoFeatureIsFoundIclkStandsIfAsked) {
  RefinerOptions options;
  const auto refined = [&] {
    return Refiner(*aligner, std::make_unique<Blind>(internal::make_cpu_feature_aligner(*aligner)), options).align(pair());
  };
  EXPECT_EQ(refined().status, Status::diverged) << "the features do not confirm anything";
  options.keep_unconfirmed = true;
  const RefinedAlignment kept = refined();
  EXPECT_TRUE(kept.converged()) << kept.reason;
  EXPECT_FALSE(kept.refined);
  EXPECT_NE(kept.reason.find("; not refined: the features do not confirm"), std::string::npos) << kept.reason;
  EXPECT_EQ(kept.T_10.matrix(), kept.iclk.T_10.matrix());
  const Matrix6d more = kept.covariance - kept.iclk.covariance;  // for errors that patches share
  EXPECT_GT(kept.iclk.covariance.trace(), 0);
  EXPECT_EQ(more.llt().info(), Eigen::Success);
  EXPECT_TRUE(kept.features.empty()) << "positions that the pose does not share";
  I1.data.assign(I1.data.size(), 0.5f);
  EXPECT_FALSE(refined().converged()) << "ICLK itself must have converged";
}

TEST_F(Refine, ConstantImagesAndNaNsAreNotConverged) {
  for (float value : {0.5f, std::numeric_limits<float>::quiet_NaN()}) {
    std::fill(I1.data.begin(), I1.data.end(), value);
    EXPECT_FALSE(claim(scene.T_10).converged());
    EXPECT_FALSE(Refiner(*aligner).align(pair()).converged());
  }
  I1 = test::render(scene, 1, 1);
  std::fill(I0.data.begin(), I0.data.end(), 0.5f);
  set_reference();
  const RefinedAlignment r = claim(scene.T_10);
  EXPECT_EQ(r.status, Status::too_few_features) << r.reason;
  EXPECT_NE(r.reason.find("low_texture"), std::string::npos) << r.reason;
}

TEST_F(Refine, TooFewFeaturesAreNotConverged) {
  features = test::random_features(scene, 7, 4);
  set_reference();
  const RefinedAlignment r = claim(scene.T_10);
  EXPECT_EQ(r.status, Status::too_few_features) << r.reason;
  features = test::random_features(scene, 0, 4);
  set_reference();
  EXPECT_FALSE(Refiner(*aligner).align(pair()).converged());
}

TEST_F(Refine, UnusableFeaturesAreLeftOut) {
  features.uv[0].x() = std::numeric_limits<double>::quiet_NaN();
  features.inverse_depth[1] = 0;
  features.uv[2] = {1, 1};
  set_reference();
  RefinerOptions options;
  options.structure = true;
  const RefinedAlignment r = Refiner(*aligner, options).align(pair());
  ASSERT_TRUE(r.converged()) << r.reason;
  for (int i = 0; i < 3; ++i) EXPECT_EQ(r.features[i].status, FeatureStatus::rejected);
  EXPECT_LT(r.visible, 48);
}

TEST_F(Refine, MorePairsThanABatchGiveTheSameAsOneByOne) {
  Refiner refiner(*aligner);
  Scene nearer = scene;
  nearer.T_10.t *= 0.5;
  const Picture I2 = test::render(nearer, 1, 2);
  Pair a = pair(), b = pair();
  b.target = I2.view();
  const std::vector<Pair> pairs{a, b, b, a, b};  // the plan holds two
  const std::vector<RefinedAlignment> all = refiner.align(pairs);
  ASSERT_EQ(all.size(), 5u);
  for (size_t i = 0; i < pairs.size(); ++i) {
    const RefinedAlignment one = refiner.align(pairs[i]);
    EXPECT_EQ(all[i].T_10.matrix(), one.T_10.matrix()) << i;
    EXPECT_EQ(all[i].status, one.status);
    EXPECT_EQ(all[i].covariance, one.covariance);
  }
  EXPECT_NE(all[0].T_10.matrix(), all[1].T_10.matrix());
  EXPECT_TRUE(refiner.align(std::span<const Pair>{}).empty());
}

TEST_F(Refine, BadOptionsAndForeignAlignersAreRefused) {
  RefinerOptions options;
  options.rounds = 0;
  EXPECT_THROW(Refiner(*aligner, options), Error);
  Overconfident foreign(*aligner, scene.T_10);
  EXPECT_THROW(Refiner{foreign}, Error);
  const auto feature_aligner = internal::make_feature_aligner(*aligner);
  using Task = internal::FeatureAlignmentTask;
  for (const Task& task : {Task{-1, 0, {}}, Task{1, 0, {}}, Task{0, 2, {}}})
    EXPECT_THROW(feature_aligner->align(std::span(&task, 1)), Error);
}

}  // namespace
}  // namespace iclk
