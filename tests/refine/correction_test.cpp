// A model's pose that no features, or few, confirm is corrected by lines, or by local contrast.
#include <algorithm>
#include <cmath>
#include <random>

#include <gtest/gtest.h>
#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/refine/cascade.h>
#include <iclk/refine/internal/verdict.h>

#include "../support/relief.h"

namespace iclk {
namespace {

using test::Frame;
using test::Relief;

/// A model with a pose of its own.
class Model : public CpuAligner {
 public:
  Model(const Plan& plan, const SE3& T_10, Status status) : CpuAligner(plan, AlignerOptions()), T_10_(T_10), status_(status) {}
  std::vector<Alignment> align(std::span<const Pair> pairs) override {
    std::vector<Alignment> found = CpuAligner::align(pairs);
    for (Alignment& a : found) {
      a.T_10 = T_10_;
      a.status = status_;
      a.covariance = Matrix6d::Identity() * 1e-6;
    }
    return found;
  }

 private:
  SE3 T_10_;
  Status status_;
};

class Correction : public testing::Test {
 protected:
  Correction() {
    relief_.camera = {260, 260, 159.5, 119.5, 320, 240};
    relief_.T_10 = SE3::exp((Vector6d() << 0.02, -0.01, 0.02, 0.003, 0.004, 0.005).finished());
    render(16);
    features_ = test::random_features(relief_, 80);
  }
  /// `shortest`: wavelength of the texture, px.
  void render(double shortest) {
    relief_.shortest = shortest;
    image0_ = test::render(relief_, 0);
    image1_ = test::render(relief_, 1);
  }
  /// Of a cascade whose model is off by `pixels`. Its features confirm nothing if they are `silent`.
  RefinedAlignment answer(double pixels, bool local_contrast = true, bool silent = true) const {
    const SE3 error = SE3::exp((Vector6d() << 0, 0, 0, 0, pixels / relief_.camera.fx, 0).finished());
    Plan plan{320, 240};
    plan.max_features = 300;
    plan.format = PixelFormat::r32f;
    RefinerOptions first, keeps;
    first.min_inliers = first_min_inliers_;
    first.min_inlier_share = first.min_clear_share = 0.1;
    keeps.min_inliers = silent ? 1000 : 10;
    keeps.min_inlier_share = least_share_;
    keeps.keep_unconfirmed = true;
    Cascade cascade(
        {{"classical", [&] { return make_cpu_aligner(plan, AlignerOptions()); }, first, local_contrast, false, false},
         {"model", [&] { return std::make_unique<Model>(plan, relief_.T_10 * error, status_); }, keeps, false, false, false}});
    CascadePair pair{{image0_.view(), relief_.camera, features_, {}}, image1_.view(), {}};
    pair.search = search_;
    return cascade.align(std::span(&pair, 1)).front();
  }
  double error(const RefinedAlignment& r) const { return test::pixel_error(relief_, features_, r.T_10); }
  double nees(const RefinedAlignment& r) const {
    const Vector6d off = (r.T_10.inverse() * relief_.T_10).log();
    return off.dot(r.covariance.ldlt().solve(off));
  }
  void invert() {
    for (float& x : image1_.data) x = 1 - x;
  }
  /// Inverts the contrast but for a share of the image, which moves by some pixels.
  void invert_but_a_part(int pixels, double share = 0.25) {
    const int width = relief_.camera.width, kept = static_cast<int>(share * relief_.camera.height);
    for (int v = 0; v < relief_.camera.height; ++v) {
      float* row = image1_.data.data() + static_cast<std::ptrdiff_t>(v) * width;
      if (v < kept)
        std::copy_backward(row, row + width - pixels, row + width);
      else
        std::transform(row, row + width, row, [](float x) { return 1 - x; });
    }
  }
  /// Adds what only one image shows.
  void add_texture(double share) {
    Relief other = relief_;
    other.seed = 7;
    const Frame only = test::render(other, 1);
    for (size_t i = 0; i < only.data.size(); ++i) image1_.data[i] += static_cast<float>(share) * only.data[i];
  }
  void add_noise(double sigma) {
    std::mt19937 random(5);
    std::normal_distribution<float> noise(0, static_cast<float>(sigma));
    for (Frame* frame : {&image0_, &image1_})
      for (float& x : frame->data) x += noise(random);
  }

  Relief relief_;
  Status status_ = Status::converged;
  bool search_ = false;           ///< lines confirm no pose that began at a first guess
  int first_min_inliers_ = 1000;  ///< of the classical aligner, which claims nothing
  double least_share_ = RefinerOptions().min_inlier_share;
  Frame image0_, image1_;
  Features features_;
};

TEST_F(Correction, LinesCorrectAModelWhereContrastIsInverted) {
  invert();
  const RefinedAlignment alone = answer(0.8, false), corrected = answer(0.8);
  ASSERT_TRUE(alone.converged() && !alone.refined) << alone.reason;
  EXPECT_NEAR(error(alone), 0.8, 0.2);
  ASSERT_TRUE(corrected.converged() && !corrected.refined) << corrected.reason;
  EXPECT_LT(error(corrected), 0.2) << corrected.reason;
  EXPECT_GT(corrected.covariance.trace(), alone.covariance.trace()) << "a shift of all lines";
  EXPECT_EQ(corrected.stages.back().name, "correction");
  EXPECT_EQ(corrected.stages.back().T_10.matrix(), corrected.T_10.matrix());
  EXPECT_EQ(corrected.model, "model");
}

TEST_F(Correction, LinesConfirmWhatGreyValuesCannot) {
  search_ = true;
  invert();
  add_texture(0.25);
  status_ = Status::degenerate;
  const RefinedAlignment refused = answer(2, false), confirmed = answer(2);
  EXPECT_FALSE(refused.converged());
  ASSERT_TRUE(confirmed.converged() && confirmed.refined && confirmed.by_lines) << confirmed.reason;
  EXPECT_LT(error(confirmed), 0.3) << confirmed.reason;
  EXPECT_NE(confirmed.reason.find("; by lines"), std::string::npos) << confirmed.reason;
  EXPECT_EQ(confirmed.attempts.back().model, "classical, lines");
  ASSERT_EQ(confirmed.features.size(), features_.uv.size());
  EXPECT_GT(count_aligned(confirmed.features), 60);
  EXPECT_NEAR(confirmed.features.front().covariance(0, 0), std::pow(confirmed.sigma, 2), 1e-12);
  ASSERT_EQ(confirmed.attempts.size(), 4u);
  EXPECT_EQ(confirmed.attempts[2].model, "model");
  EXPECT_LT(nees(confirmed), 12.6) << "95 % of a chi-square of 6";
}

TEST_F(Correction, TheCovarianceByLinesHoldsTheErrors) {
  search_ = true;
  constexpr int kSeeds = 8;
  double sum = 0;
  for (int seed = 1; seed <= kSeeds; ++seed) {
    relief_.seed = static_cast<uint32_t>(seed);
    render(16);
    features_ = test::random_features(relief_, 300);
    invert();
    add_texture(0.3);
    const RefinedAlignment confirmed = answer(2);
    ASSERT_TRUE(confirmed.by_lines) << confirmed.reason;
    sum += nees(confirmed);
  }
  EXPECT_LT(sum / kSeeds, 6) << "patches overlap";
}

TEST_F(Correction, ModelsAreNotAskedIfLinesConfirm) {
  search_ = true;
  add_texture(0.5);
  const RefinedAlignment confirmed = answer(2);
  ASSERT_TRUE(confirmed.by_lines) << confirmed.reason;
  EXPECT_LT(error(confirmed), 0.3) << confirmed.reason;
  EXPECT_EQ(confirmed.attempts.size(), 3u);
}

TEST_F(Correction, LinesReplaceAWeakClaimOfTheFirstLook) {
  search_ = true;
  first_min_inliers_ = 10;
  add_texture(0.6);
  const RefinedAlignment weak = answer(2, false), confirmed = answer(2);
  ASSERT_TRUE(internal::weakly_confirmed(weak)) << weak.reason;
  ASSERT_EQ(weak.model, "classical");
  ASSERT_TRUE(confirmed.by_lines) << confirmed.reason;
  EXPECT_LT(error(confirmed), error(weak));
  EXPECT_EQ(confirmed.attempts.size(), 2u);
}

TEST_F(Correction, LinesOfFewFeaturesOrOfASmallPartConfirmNothing) {
  search_ = true;
  invert();
  add_texture(0.25);
  status_ = Status::degenerate;
  const Features all = features_;
  features_ = test::random_features(relief_, 39);
  EXPECT_FALSE(answer(2).converged()) << "39 features";
  features_ = all;
  ASSERT_TRUE(answer(2).converged());
  Relief elsewhere = relief_;
  elsewhere.seed = 9;
  const Frame other = test::render(elsewhere, 1);
  for (int v = 0; v < other.height; ++v)
    for (int u = other.width * 2 / 5; u < other.width; ++u)
      image1_.at(u, v) = other.data[static_cast<size_t>(v) * other.width + u];
  const RefinedAlignment part = answer(0.5);
  EXPECT_FALSE(part.converged()) << part.reason;
  EXPECT_LT(error(part), 3) << "lines agree, but not enough: " << part.reason;
}

TEST_F(Correction, LinesDoNotConfirmAFirstGuess) {
  invert();
  add_texture(0.25);
  status_ = Status::degenerate;
  const RefinedAlignment corrected = answer(2);
  EXPECT_FALSE(corrected.converged());
  EXPECT_LT(error(corrected), 0.3) << corrected.reason;
}

TEST_F(Correction, NoiseHidesLines) {
  add_noise(0.08);
  const RefinedAlignment alone = answer(2, false), mean = answer(2);
  EXPECT_NEAR(error(alone), 2, 0.3);
  EXPECT_NEAR(error(mean), 1, 0.3) << mean.reason;
  EXPECT_NE(mean.reason.find("mean with the pose by local contrast"), std::string::npos) << mean.reason;
  const RefinedAlignment far = answer(4);
  EXPECT_NEAR(error(far), 4, 0.5) << "not the same pose: " << far.reason;
}

TEST_F(Correction, AClaimThatLinesContradictIsRefused) {
  invert();
  const RefinedAlignment alone = answer(2, false), refused = answer(2);
  ASSERT_TRUE(alone.converged()) << alone.reason;
  EXPECT_EQ(refused.status, Status::diverged) << refused.reason;
  EXPECT_TRUE(refused.covariance.isZero(0));
  EXPECT_EQ(refused.reason.rfind("lines contradict the pose: ", 0), 0u) << refused.reason;
  EXPECT_LT(error(refused), 0.2) << refused.reason;
  status_ = Status::degenerate;
  EXPECT_LT(error(answer(2)), 0.2);
}

TEST_F(Correction, FarPosesStay) {
  invert();
  status_ = Status::degenerate;
  const RefinedAlignment near = answer(3.2), far = answer(14);
  EXPECT_LT(error(near), 0.2) << near.reason;
  EXPECT_NEAR(error(far), 14, 2) << far.reason;
}

TEST_F(Correction, ConfirmedPosesStay) {
  const RefinedAlignment confirmed = answer(0.5, true, false);
  ASSERT_TRUE(confirmed.refined) << confirmed.reason;
  EXPECT_EQ(confirmed.T_10.matrix(), answer(0.5, false, false).T_10.matrix());
}

TEST_F(Correction, LinesOutvoteFewConfirmingFeatures) {
  least_share_ = 0.1;
  invert_but_a_part(1);
  const RefinedAlignment alone = answer(0, false, false), corrected = answer(0, true, false);
  ASSERT_TRUE(alone.converged() && alone.refined) << alone.reason;
  EXPECT_GT(error(alone), 0.5) << alone.reason;
  ASSERT_TRUE(corrected.converged() && corrected.refined) << corrected.reason;
  EXPECT_LT(error(corrected), 0.3) << corrected.reason;
  EXPECT_NE(corrected.reason.find("pose by lines, on which"), std::string::npos) << corrected.reason;
  EXPECT_GT(corrected.covariance.trace(), alone.covariance.trace()) << "a shift of all lines";
}

TEST_F(Correction, LinesRefuseFewConfirmingFeaturesThatAreFarOff) {
  least_share_ = 0.1;
  invert_but_a_part(2);
  const RefinedAlignment alone = answer(0, false, false), refused = answer(0, true, false);
  ASSERT_TRUE(alone.converged() && alone.refined) << alone.reason;
  EXPECT_GT(error(alone), 1) << alone.reason;
  EXPECT_EQ(refused.status, Status::diverged) << refused.reason;
  EXPECT_FALSE(refused.refined);
  EXPECT_LT(error(refused), 0.5) << refused.reason;
}

TEST_F(Correction, LinesRefuseWhatTheyDoNotClearlyOutvote) {
  least_share_ = 0.1;
  invert_but_a_part(3, 0.45);
  const RefinedAlignment alone = answer(0, false, false), refused = answer(0, true, false);
  ASSERT_TRUE(alone.converged() && alone.refined) << alone.reason;
  EXPECT_EQ(refused.status, Status::diverged) << refused.reason;
  EXPECT_EQ(refused.T_10.matrix(), alone.T_10.matrix()) << "fewer than twice as many agree";
  EXPECT_NE(refused.reason.find("; another pose by lines"), std::string::npos) << refused.reason;
}

TEST_F(Correction, AShiftOfAllLinesIsInTheCovariance) {
  search_ = true;
  invert();
  add_texture(0.25);
  const int width = relief_.camera.width;
  for (int v = 0; v < relief_.camera.height; ++v) {
    float* row = image1_.data.data() + static_cast<std::ptrdiff_t>(v) * width;
    std::copy_backward(row, row + width - 1, row + width);
  }
  status_ = Status::degenerate;
  const RefinedAlignment confirmed = answer(2);
  ASSERT_TRUE(confirmed.by_lines) << confirmed.reason;
  EXPECT_NEAR(error(confirmed), 1, 0.3);
  EXPECT_LT(nees(confirmed), 25) << "three sigma and some noise";
}

}  // namespace
}  // namespace iclk
