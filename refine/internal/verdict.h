#pragma once
#include <span>
#include <string>

#include <iclk/refine/refiner.h>

namespace iclk::internal {

/// The state of a pair after its last round.
struct Evidence {
  int visible = 0;     ///< features whose patches the pose projects into image 1
  int candidates = 0;  ///< of these, the ones with texture; the others do not constrain the pose
  int aligned = 0, inliers = 0, rounds = 0;
  bool credible = false;   ///< ICLK's pose is usable, and counts without features (RefinerOptions::keep_unconfirmed)
  bool half_size = false;  ///< the features were found in images of half the size
  bool guessed = false;    ///< the pose started at a first guess, without a search
  double sigma = 0;        ///< px, of the reprojection residuals
  double correction = 0;   ///< px, median over the features of their motion by the refinement
  Status pose_status = Status::diverged;
  std::string pose_reason;
};

struct Verdict {
  Status status = Status::diverged;
  std::string reason;
  bool compatible = true;  ///< false: the features contradict ICLK's pose
};

/// Whether the features found the pose of a learned model again.
bool found_again(const Evidence& evidence, const RefinerOptions& options);

/// The verdict on alignment and refinement. shaders/refine/refine_verdict.comp applies the same rules.
Verdict judge(const Evidence& evidence, std::span<const AlignedFeature> features, const Recolouring& recolouring,
              const RefinerOptions& options);

/// The verdict on a pair that is aligned in another way. It refuses answers that too few features confirm, because one of
/// several ways may agree by chance. Blur also removes texture, so that few features speak. A learned model with the same
/// pose is evidence enough.
void judge_second_look(RefinedAlignment& answer);

/// Whether fewer than half of the visible features confirm a claim, with positions as imprecise as where grey values differ.
bool weakly_confirmed(const RefinedAlignment& answer);

/// The options of a refinement by lines. It keeps no unconfirmed pose, and finds no bend of the target, because its residuals
/// are too large. Answers and rivals need 40 features and half of the visible ones.
RefinerOptions by_lines(RefinerOptions options);
/// Whether an answer from by_lines() may be claimed. Grey values decide where positions are as precise as in equal light. Lines
/// confirm nothing where the texture repeats.
bool confirmed_by_lines(const RefinedAlignment& answer);

/// For example "38 of 50 features within 1.5 px".
std::string inliers_text(int inliers, int used, const PoseOptions& options);

}  // namespace iclk::internal
