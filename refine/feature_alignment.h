#pragma once
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace iclk {

enum class FeatureStatus : uint8_t {
  aligned,
  diverged,      ///< the steps did not converge, or led farther than max_motion from the projected position
  out_of_image,  ///< behind camera 1, or the patch is not inside image 0 or image 1
  low_texture,   ///< the patch does not determine a position
  bad_match,     ///< the patch and the target differ at the final position
  rejected,      ///< FeatureCheck is not ok: the feature was not used
  hidden,        ///< the patch in image 1 covers hidden pixels (Pair::target_mask), at the start or later
};
const char* name(FeatureStatus status);

/// A feature of image 0 found in image 1.
struct AlignedFeature {
  /// The final position in px of level 0 of image 1; finite for every status.
  Eigen::Vector2d uv1 = Eigen::Vector2d::Zero();
  /// The covariance of uv1, px^2; zero unless aligned. It includes photometric noise only: the variance of the residuals times
  /// the inverse of the 2x2 Schur complement. Positions by lines (see Cascade) have the variance of the reprojection residuals.
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();
  double gain = 1, bias = 0;  ///< I1 = gain I0 + bias in the patch; I1 in the grey values of RefinedAlignment::recolouring
  double correlation = 0;     ///< of the warped patch and the target, in [-1, 1]
  int iterations = 0;         ///< sum over the levels
  FeatureStatus status = FeatureStatus::rejected;
};

/// The number of features with status aligned.
int count_aligned(std::span<const AlignedFeature> features);

/// A summary, for example "38 of 50 features aligned (4 bad_match, 8 rejected)".
std::string summary(std::span<const AlignedFeature> features);

struct FeatureAlignmentOptions {
  int iterations = 15;           ///< at most, per level
  double step_tolerance = 0.01;  ///< px: a smaller step ends a level; a level whose last step is larger has diverged
  /// The largest distance from the projected to the aligned position, px of level 0. Poses of hololens_80 that start 7 px off
  /// recover in 18 of 20 pairs with 8 px, but in only 6 with 4 px.
  double max_motion = 8;
  double min_correlation = 0.85;
  /// The smallest lower eigenvalue per pixel of the patch's 2x2 gradient matrix, with gain and bias projected out:
  /// (grey / px)^2, grey in [0, 1]. The default is six times the value that rounding to 8 bits causes. Five times the default
  /// rejected features that could be aligned, in images of low contrast.
  double min_texture = 4e-6;
  /// After its first round, a Refiner converts a colour target to the grey values that best fit the reference (Recolouring).
  bool recolour = true;

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

}  // namespace iclk
