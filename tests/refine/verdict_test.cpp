#include <cmath>

#include <gtest/gtest.h>
#include <iclk/refine/internal/rounds.h>
#include <iclk/refine/internal/verdict.h>

namespace iclk {
namespace {

TEST(Verdict, FeaturesThatAlignAndDisagreeSpeakAgainstAPose) {
  internal::Evidence e;  // of a model's claim that was 25 px off: mirrored depths
  e.visible = 200;
  e.candidates = 198;  // of which 70 are needed
  e.aligned = 97;
  e.inliers = 62;
  const auto compatible = [&] { return internal::judge(e, {}, {}, {}).compatible; };
  EXPECT_FALSE(compatible());
  e.inliers = 67;
  EXPECT_TRUE(compatible()) << "nearly all agree";
  e.aligned = 60;
  e.inliers = 20;
  EXPECT_TRUE(compatible()) << "severe changes: few can be aligned, for the pose or against it";
  for (const double correction : {1.3, std::nan("")}) {  // a lamp that moves: 4 px off
    e.correction = correction;
    EXPECT_FALSE(compatible()) << "the few that agree have another pose";
  }
  e.aligned = 97;
  e.guessed = true;
  EXPECT_TRUE(compatible());
}

TEST(Verdict, FewFeaturesAreEnoughOnlyIfAskedAndIfNearlyAllAgree) {
  internal::Evidence e;
  e.visible = e.candidates = 200;
  e.aligned = 50;
  e.inliers = 46;
  e.pose_status = Status::converged;
  RefinerOptions options;
  const auto status = [&] { return internal::judge(e, {}, {}, options).status; };
  EXPECT_EQ(status(), Status::diverged);
  options.min_clear_share = 0.2;
  EXPECT_EQ(status(), Status::converged);
  e.inliers = 44;
  EXPECT_EQ(status(), Status::diverged) << "six of fifty speak against it";
  e.aligned = e.inliers = 39;
  EXPECT_EQ(status(), Status::diverged) << "too few";
}

TEST(Verdict, FewFeaturesThatFindTheSamePoseAsAModelAreEnough) {
  internal::Evidence given;  // a pair of summer and autumn
  given.visible = given.candidates = 200;
  given.aligned = 50;
  given.inliers = 30;
  given.sigma = 0.4;
  given.correction = 0.8;
  given.credible = true;
  given.pose_status = Status::converged;
  const auto confirmed = [&](auto&& change) {
    internal::Evidence e = given;
    change(e);
    return internal::judge(e, {}, {}, {}).status == Status::converged;
  };
  EXPECT_TRUE(confirmed([](internal::Evidence&) {}));
  EXPECT_FALSE(confirmed([](internal::Evidence& e) { e.credible = false; })) << "both poses are of grey values";
  EXPECT_FALSE(confirmed([](internal::Evidence& e) { e.guessed = true; }));
  EXPECT_FALSE(confirmed([](internal::Evidence& e) { e.inliers = 26; })) << "half of them agree by chance";
  EXPECT_FALSE(confirmed([](internal::Evidence& e) { e.aligned = e.inliers = 29; })) << "too few";
  EXPECT_FALSE(confirmed([](internal::Evidence& e) { e.candidates = 57, e.inliers = e.aligned = 9; })) << "too few";
  for (const double bad : {1.1, std::nan("")}) {
    EXPECT_FALSE(confirmed([&](internal::Evidence& e) { e.correction = bad; })) << "another pose";
    EXPECT_FALSE(confirmed([&](internal::Evidence& e) { e.sigma = bad; })) << "agreement by chance";
  }
}

TEST(Verdict, AnInlierMayBeTwiceAsFarAtHalfTheSize) {
  internal::PoseCandidate candidate;
  EXPECT_EQ(candidate.options_for({}).pose.inlier_distance, PoseOptions().inlier_distance);
  candidate.level = 1;
  EXPECT_EQ(candidate.options_for({}).pose.inlier_distance, 2 * PoseOptions().inlier_distance);
}

TEST(Verdict, AtHalfTheSizeAModelsPoseMayBeFurtherAndResidualsMayNot) {
  internal::Evidence e;
  e.visible = e.candidates = 200;
  e.aligned = 60;
  e.inliers = 50;
  e.credible = e.half_size = true;
  e.correction = 1.9;  // under severe changes
  e.sigma = 0.49;
  EXPECT_TRUE(internal::found_again(e, {}));
  e.sigma = 0.52;
  EXPECT_FALSE(internal::found_again(e, {})) << "mirrored depths: 4.6 px off";
  e.sigma = 0.3;
  e.correction = 2.1;
  EXPECT_FALSE(internal::found_again(e, {}));
  e.correction = 0.8;
  e.candidates = 40;
  e.inliers = e.aligned = 19;
  EXPECT_FALSE(internal::found_again(e, {})) << "no more precise than the model";
  e.inliers = e.aligned = 20;
  EXPECT_TRUE(internal::found_again(e, {}));
  e.candidates = 200;
  e.aligned = 60;
  e.inliers = 49;
  EXPECT_FALSE(internal::found_again(e, {})) << "two seasons: 1.4 px off";
}

TEST(Verdict, FewImpreciseFeaturesConfirmWeakly) {
  RefinedAlignment r;
  r.status = Status::converged;
  r.refined = true;
  r.visible = 100;
  r.inliers = 49;
  r.sigma = 0.3;
  EXPECT_TRUE(internal::weakly_confirmed(r));
  r.inliers = 50;
  EXPECT_FALSE(internal::weakly_confirmed(r));
  r.inliers = 49;
  r.sigma = 0.29;
  EXPECT_FALSE(internal::weakly_confirmed(r)) << "few, but precise: most of the scene is hidden";
  r.sigma = 0.3;
  r.refined = false;
  EXPECT_FALSE(internal::weakly_confirmed(r));
}

TEST(Verdict, LinesConfirmOnlyWhatGreyValuesCannot) {
  RefinedAlignment r;
  r.status = Status::converged;
  r.refined = true;
  r.sigma = 0.5;
  r.features.resize(200);
  r.inliers = 57;
  EXPECT_FALSE(internal::confirmed_by_lines(r)) << "tiles of a mirrored floor, at the border of the image";
  r.inliers = 67;
  EXPECT_TRUE(internal::confirmed_by_lines(r));
  r.sigma = 0.23;
  EXPECT_FALSE(internal::confirmed_by_lines(r)) << "equal light: an object that hides half of the scene";
  r.sigma = 1.2;
  EXPECT_FALSE(internal::confirmed_by_lines(r)) << "mirrored depths";
  r.sigma = 0.36;
  r.iclk.repeats = 0.89;
  EXPECT_FALSE(internal::confirmed_by_lines(r)) << "windows of a house";
  r.iclk.repeats = 0.5;
  EXPECT_TRUE(internal::confirmed_by_lines(r));
  r.status = Status::ambiguous;
  EXPECT_FALSE(internal::confirmed_by_lines(r));
}

}  // namespace
}  // namespace iclk
