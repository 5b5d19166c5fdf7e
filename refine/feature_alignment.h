#pragma once
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace iclk {

enum class FeatureStatus : uint8_t {
  aligned,
  diverged,      ///< the steps did not die out, or led further than max_motion from the projected position
  out_of_image,  ///< behind camera 1, or the patch is not inside image 0 or image 1
  low_texture,   ///< the patch does not determine a position
  bad_match,     ///< the patch and the target do not look alike where the steps ended
  rejected,      ///< FeatureCheck is not ok: the feature never took part
  hidden,        ///< the patch in image 1 lies on hidden pixels (Pair::target_mask) or came to
};
const char* name(FeatureStatus status);

/// A feature of image 0 found in image 1.
struct AlignedFeature {
  Eigen::Vector2d uv1 =
      Eigen::Vector2d::Zero();  ///< px of level 0 of image 1; where the search ended, whatever the status (finite)
  /// px^2, of uv1; zero unless aligned. Photometric noise only: residual variance times the inverse of the 2x2 Schur
  /// complement.
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();
  double gain = 1, bias = 0;  ///< I1 = gain I0 + bias in the patch; I1 with the task's GreyWeights
  double correlation = 0;     ///< of the warped patch and the target, in [-1, 1]
  int iterations = 0;         ///< of all levels
  FeatureStatus status = FeatureStatus::rejected;
};

/// How many are aligned.
int count_aligned(std::span<const AlignedFeature> features);

/// "38 of 50 features aligned (4 bad_match, 8 rejected)".
std::string summary(std::span<const AlignedFeature> features);

struct FeatureAlignmentOptions {
  int iterations = 15;           ///< at most, a level
  double step_tolerance = 0.01;  ///< px: a smaller step ends a level; a level whose last step is larger has diverged
  /// px of level 0 from the projected to the aligned position. On hololens_80, poses 7 px off come back in 18 of 20 pairs with
  /// 8 px, in 6 with 4 px.
  double max_motion = 8;
  double min_correlation = 0.85;
  /// Smaller eigenvalue of the patch's 2x2 gradient matrix with gain and bias projected out, per pixel: (grey / px)^2, grey in
  /// [0, 1]. The default is six times what rounding to 8 bits puts there; five times as much left features out of images of low
  /// contrast that could be aligned.
  double min_texture = 4e-6;
  /// After its first round a Refiner looks at a target with colours in the grey values that fit the reference's (Recolouring).
  bool recolour = true;

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

}  // namespace iclk
