// A pair goes from one model to the next until one converges. CPU aligners stand for the models: the first without a search.
#include <gtest/gtest.h>
#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/engine/error.h>
#include <iclk/refine/cascade.h>
#include <iclk/refine/internal/verdict.h>

#include "../support/relief.h"
#include "rival_scenes.h"

namespace iclk {
namespace {

using test::Frame;
using test::Relief;

struct Scene {
  explicit Scene(double turn, uint32_t seed = 1) {
    relief.camera = {130, 130, 79.5, 59.5, 160, 120};
    relief.seed = seed;
    Vector6d xi = Vector6d::Zero();
    xi << 0.05, -0.03, 0.04, 0.01, turn, 0.02;
    relief.T_10 = SE3::exp(xi);
    image0 = test::render(relief, 0);
    image1 = test::render(relief, 1);
    features = test::random_features(relief, 60);
  }
  CascadePair pair() const { return {{image0.view(), relief.camera, features, {}}, image1.view(), {}}; }

  Relief relief;
  Frame image0, image1;
  Features features;
};

AlignerOptions options_of(bool search) {
  AlignerOptions options;
  options.levels = 3;
  options.search = search;
  return options;
}

class Cascaded : public testing::Test {
 protected:
  Cascade::Step step(const std::string& model, bool search, bool refine = true) {
    Plan plan{160, 120};
    plan.max_features = 60;
    plan.max_references = plan.max_pairs = 3;
    plan.format = PixelFormat::r32f;
    const auto make = [this, plan, search] {
      ++made_;
      return make_cpu_aligner(plan, options_of(search));
    };
    return {model, make, refine ? std::optional(RefinerOptions()) : std::nullopt};
  }
  int made_ = 0;
  Scene near_{0.01}, far_{0.3}, other_{0.01, 9};
};

TEST_F(Cascaded, EachPairIsAnsweredByTheFirstThatConverges) {
  Cascade cascade({step("plain", false), step("searching", true)});
  CascadePair unrelated = near_.pair();
  unrelated.target = other_.image1.view();
  const CascadePair pairs[] = {near_.pair(), far_.pair(), unrelated};
  const auto results = cascade.align(pairs);
  ASSERT_EQ(results.size(), 3u);
  EXPECT_EQ(results[0].model, "plain");
  EXPECT_EQ(results[0].attempts.size(), 1u);
  EXPECT_TRUE(results[0].converged()) << results[0].reason;
  EXPECT_LT(test::pixel_error(near_.relief, near_.features, results[0].T_10), 0.1);

  EXPECT_EQ(results[1].model, "searching");
  ASSERT_EQ(results[1].attempts.size(), 2u);
  EXPECT_EQ(results[1].attempts[0].model, "plain");
  EXPECT_NE(results[1].attempts[0].status, Status::converged);
  EXPECT_EQ(results[1].attempts[1].status, Status::converged);
  EXPECT_TRUE(results[1].converged()) << results[1].reason;
  EXPECT_LT(test::pixel_error(far_.relief, far_.features, results[1].T_10), 0.1);

  EXPECT_EQ(results[2].model, "searching") << "the last one's word";
  EXPECT_FALSE(results[2].converged()) << results[2].reason;
  EXPECT_EQ(results[2].reason, results[2].attempts.back().reason);
}

TEST_F(Cascaded, AnAnswerIsThatOfItsModelAloneToTheLastBit) {
  Cascade cascade({step("plain", false), step("searching", true)});
  Cascade alone({step("searching", true)});
  const CascadePair pairs[] = {near_.pair(), far_.pair()}, one[] = {far_.pair()};
  const auto together = cascade.align(pairs), single = alone.align(one);
  EXPECT_EQ(together[1].T_10.t, single[0].T_10.t);
  EXPECT_EQ(together[1].T_10.R, single[0].T_10.R);
  EXPECT_EQ(together[1].covariance, single[0].covariance);
}

TEST_F(Cascaded, AModelThatNobodyNeedsIsNotMade) {
  Cascade cascade({step("plain", false), step("searching", true)});
  EXPECT_EQ(made_, 1);
  const CascadePair near[] = {near_.pair(), near_.pair()}, far[] = {far_.pair()};
  cascade.align(near);
  EXPECT_EQ(made_, 1);
  cascade.align(far);
  cascade.align(far);
  EXPECT_EQ(made_, 2);
  EXPECT_TRUE(cascade.align(std::span<const CascadePair>()).empty());
  EXPECT_GT(cascade.times().setup, 0);
  EXPECT_GT(cascade.times().align, 0);
}

TEST_F(Cascaded, WithoutRefinementTheAlignmentsOwnWordCounts) {
  Cascade cascade({step("plain", false, false), step("searching", true, false)});
  const CascadePair pairs[] = {near_.pair(), far_.pair()};
  const auto results = cascade.align(pairs);
  EXPECT_EQ(results[0].model, "plain");
  EXPECT_EQ(results[1].model, "searching");
  for (const auto& r : results) {
    EXPECT_TRUE(r.converged()) << r.reason;
    EXPECT_FALSE(r.refined);
    EXPECT_EQ(r.stages.size(), 1u);
  }
}

TEST_F(Cascaded, PreparedKeyframesGiveTheAnswersOfWholePairs) {
  Cascade cascade({step("plain", false), step("searching", true)});
  Cascade whole({step("plain", false), step("searching", true)});
  {
    Scene gone(0.3);  // its pixels are read again when the second model is asked
    cascade.set_reference(2, {gone.image0.view(), gone.relief.camera, gone.features, {}});
  }
  cascade.set_reference(0, near_.pair().reference);
  ASSERT_NE(cascade.reference(2), nullptr);
  EXPECT_EQ(cascade.reference(1), nullptr);
  const CascadePair given[] = {far_.pair(), near_.pair(), far_.pair()};
  const Pair pairs[] = {{2, far_.image1.view()}, {0, near_.image1.view()}, {2, far_.image1.view()}};
  const auto expected = whole.align(given);
  for (int round = 0; round < 2; ++round) {
    const auto results = cascade.align(pairs);
    for (size_t i = 0; i < 3; ++i) {
      EXPECT_EQ(results[i].model, expected[i].model);
      EXPECT_EQ(results[i].T_10.t, expected[i].T_10.t);
      EXPECT_EQ(results[i].covariance, expected[i].covariance);
    }
  }
  EXPECT_EQ(made_, 4) << "two models of each";
  // A slot that is set anew is another keyframe for every model.
  cascade.set_reference(2, other_.pair().reference);
  const Pair other[] = {{2, other_.image1.view()}};
  EXPECT_TRUE(cascade.align(other)[0].converged());
  EXPECT_FALSE(cascade.align(pairs)[0].converged());

  const Pair unset[] = {{1, near_.image1.view()}};
  EXPECT_THROW(cascade.align(unset), Error);
  EXPECT_THROW(cascade.set_reference(3, near_.pair().reference), Error);
  cascade.align(given);
  EXPECT_EQ(cascade.reference(0), nullptr) << "whole pairs take the slots";
  EXPECT_THROW(cascade.align(pairs), Error);
}

/// One that writes over its slot and then throws, as on a lost device, whenever it is told to.
class Failing : public Aligner {
 public:
  Failing(std::unique_ptr<Aligner> aligner, const bool& fails) : aligner_(std::move(aligner)), fails_(fails) {}
  std::vector<FeatureCheck> set_reference(int slot, const Reference& reference) override {
    auto checks = aligner_->set_reference(slot, reference);
    if (fails_) throw Error(ErrorCode::device_lost, "lost");
    return checks;
  }
  std::vector<Alignment> align(std::span<const Pair> pairs) override { return aligner_->align(pairs); }
  const Camera& camera(int slot) const override { return aligner_->camera(slot); }
  const Features& features(int slot) const override { return aligner_->features(slot); }
  const std::vector<FeatureCheck>& checks(int slot) const override { return aligner_->checks(slot); }
  const Plan& plan() const override { return aligner_->plan(); }

 private:
  std::unique_ptr<Aligner> aligner_;
  const bool& fails_;
};

TEST_F(Cascaded, AKeyframeStaysWhereItsSuccessorFails) {
  bool fails = false;
  Cascade::Step failing = step("plain", false, false);
  failing.make = [make = failing.make, &fails] { return std::make_unique<Failing>(make(), fails); };
  Cascade cascade({failing});
  cascade.set_reference(0, near_.pair().reference);
  const Pair pairs[] = {{0, near_.image1.view()}};
  const SE3 before = cascade.align(pairs)[0].T_10;
  fails = true;
  EXPECT_THROW(cascade.set_reference(0, other_.pair().reference), Error);
  fails = false;
  EXPECT_EQ(cascade.align(pairs)[0].T_10.matrix(), before.matrix());
  EXPECT_EQ(cascade.reference(0)->features.uv, near_.features.uv);
}

TEST_F(Cascaded, WhatCannotBeMadeIsAnError) {
  EXPECT_THROW(Cascade({}), Error);
  Cascade::Step broken = step("broken", false);
  broken.make = []() -> std::unique_ptr<Aligner> { throw Error(ErrorCode::unsupported, "too large"); };
  EXPECT_THROW(Cascade({broken}), Error);
  Cascade later({step("plain", false), broken});
  const CascadePair near[] = {near_.pair()}, far[] = {far_.pair()};
  EXPECT_TRUE(later.align(near)[0].converged());
  EXPECT_THROW(later.align(far), Error);
  EXPECT_TRUE(later.align(near)[0].converged()) << "and nothing is broken by it";
}

TEST(Overlay, ItsOtherFeaturesAreNoOtherPose) {
  using namespace test::rivals;
  const Waves scene(0, 6), vehicle(0, 7);
  const auto wall = [&](double x, double y) { return 0.5 + 0.05 * scene(x, y); };
  const auto shown = [&](double shift) {
    return render([&, shift](double x, double y) { return 0.5 + 0.05 * vehicle(x - shift, y); }, SE3(), 3);
  };
  const Frame fixed = shown(0);
  Frame image0 = render(wall, SE3(), 1), image1 = render(wall, sideways(0.25, 0.1), 2), shaken = shown(0.004);  // 0.26 px
  for (int v = 0; v < shaken.height; ++v)
    for (int u = 0; u < 120; ++u) shaken.at(u, v) = fixed.data[static_cast<size_t>(v * shaken.width + u)];
  overlay(image0, fixed, 60, 240);
  overlay(image1, shaken, 60, 240);
  const auto make = [] {
    Plan plan{kCamera.width, kCamera.height};
    plan.max_features = 300;
    plan.format = PixelFormat::r32f;
    return make_cpu_aligner(plan, options_of(true));
  };
  Cascade cascade({{"searching", make, RefinerOptions()}});
  const CascadePair pair{{image0.view(), kCamera, lattice(kDistance), {}}, image1.view(), {}};
  const RefinedAlignment r = cascade.align({&pair, 1}).front();
  EXPECT_EQ(r.status, Status::ambiguous) << r.reason;
}

TEST(SecondLook, FindsAnyRoll) {
  Plan plan{320, 240};
  plan.max_features = 120;
  plan.format = PixelFormat::r32f;
  Cascade::Step step{"classical", [&] { return make_cpu_aligner(plan, options_of(true)); }, RefinerOptions()};
  step.gradients = true;
  Cascade cascade({step});
  for (const int degrees : {50, 100, 180, 265}) {
    Relief relief;
    relief.camera = {260, 260, 159.5, 119.5, 320, 240};
    relief.T_10 = SE3::exp((Vector6d() << 0.05, -0.03, 0.04, 0.01, 0.02, degrees * M_PI / 180).finished());
    const Frame image0 = test::render(relief, 0), image1 = test::render(relief, 1);
    const Features features = test::random_features(relief, 120);
    const CascadePair pair{{image0.view(), relief.camera, features, {}}, image1.view(), {}};
    const RefinedAlignment r = cascade.align(std::span(&pair, 1)).front();
    EXPECT_TRUE(r.converged()) << degrees << ": " << r.reason;
    EXPECT_LT(test::pixel_error(relief, features, r.T_10), 0.1) << degrees;
  }
}

TEST(SecondLook, NeedsClearEvidence) {
  const auto refused = [](int inliers, int aligned, int visible, bool refined = true, bool found_again = false) {
    RefinedAlignment r;
    r.status = Status::converged;
    r.covariance.setIdentity();
    r.inliers = inliers, r.aligned = aligned, r.visible = visible, r.refined = refined, r.found_again = found_again;
    internal::judge_second_look(r);
    EXPECT_EQ(r.converged(), r.reason.empty()) << r.reason;
    EXPECT_NE(r.converged(), r.covariance.isZero());
    return !r.converged();
  };
  EXPECT_FALSE(refused(80, 100, 200));
  EXPECT_TRUE(refused(79, 100, 200)) << "a fifth of the aligned features has another pose";
  EXPECT_FALSE(refused(40, 40, 200));
  EXPECT_TRUE(refused(39, 39, 200)) << "most features say nothing";
  EXPECT_FALSE(refused(39, 70, 200, true, true)) << "a learned model has the same pose";
  EXPECT_FALSE(refused(0, 0, 200, false)) << "a model's own claim, without features";
}

}  // namespace
}  // namespace iclk
