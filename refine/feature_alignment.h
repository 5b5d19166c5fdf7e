#pragma once
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/align/pyramid.h>
#include <iclk/align/se3.h>
#include <iclk/refine/recolour.h>

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
  ColourSums colours;         ///< where the task asks, the target has colours and the status is aligned
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
  /// After its first round a Refiner looks at a target with colours in the grey values that fit the reference's (recolour.h).
  bool recolour = true;

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// Where a feature's neighbourhood goes: u1(u0) = project(R ray(u0) + q t), the patch lying in the plane z = 1 / q of camera 0.
struct PatchWarp {
  Eigen::Vector2d uv1;  ///< the feature in image 1, px of level 0
  Eigen::Matrix2d A;    ///< du1 / du0 at the feature, the same on every level
  bool valid = false;   ///< in front of camera 1 and A invertible
};
PatchWarp warp_patch(const Camera& camera, const Eigen::Vector2d& uv0, double q, const SE3& T_10);

/// The position in image 1 of the feature at `uv0` (px, sub-pixel) with inverse depth `q` > 0: Lucas-Kanade over (du, dv, gain,
/// bias) of an 8x8 patch that is centred on the feature and warped affinely by T_10, inverse compositional (the warped patch is
/// the template).
///
/// `f0`, `f1`: grey pyramids of the same sizes as `camera` and its levels, finest first; level 1 is used where it is there.
/// Every input is fine: a NaN gives a status, not a position. The shader feature_alignment.comp follows this function stage by
/// stage.
AlignedFeature align_feature(const Pyramid& f0, const Pyramid& f1, const Camera& camera, const Eigen::Vector2d& uv0, double q,
                             const SE3& T_10, const FeatureAlignmentOptions& options = {});

/// Of the patch that align_feature() has aligned at `uv1`; `f0` is level 0, `rgb1` as rgb_maps() makes it. Precondition: it is
/// aligned, with this pose.
ColourSums colour_sums(const Map& f0, std::span<const Map> rgb1, const Camera& camera, const Eigen::Vector2d& uv0, double q,
                       const SE3& T_10, const Eigen::Vector2d& uv1);

}  // namespace iclk
