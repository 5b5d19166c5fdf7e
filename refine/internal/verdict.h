#pragma once
#include <span>
#include <string>

#include <iclk/refine/refiner.h>

namespace iclk::internal {

/// What a pair shows after its last round.
struct Evidence {
  int visible = 0;     ///< features whose patch the pose puts inside image 1
  int candidates = 0;  ///< of these, with texture: the rest says nothing about the pose
  int aligned = 0, inliers = 0, rounds = 0;
  bool guessed = false;   ///< the pose began at a first guess, and was not searched for
  double sigma = 0;       ///< px, of the reprojection residuals
  double correction = 0;  ///< px, median over the features of what refinement moved them by
  Status pose_status = Status::diverged;
  std::string pose_reason;
};

struct Verdict {
  Status status = Status::diverged;
  std::string reason;
  bool compatible = true;  ///< false: the features speak against the pose that ICLK found
};

/// Over the whole way. shaders/refine/refine_verdict.comp decides alike.
Verdict judge(const Evidence& evidence, std::span<const AlignedFeature> features, const Recolouring& recolouring,
              const RefinerOptions& options);

/// "38 of 50 features within 1.5 px".
std::string inliers_text(int inliers, int used, const PoseOptions& options);

}  // namespace iclk::internal
