#pragma once
#include <span>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/pyramid.h>
#include <iclk/align/se3.h>
#include <iclk/refine/feature_alignment.h>
#include <iclk/refine/internal/recolour.h>

namespace iclk::internal {

/// The affine warp of a feature's patch: u1(u0) = project(R ray(u0) + q t). The patch lies in the plane z = 1 / q of camera 0.
struct PatchWarp {
  Eigen::Vector2d uv1;  ///< the feature in image 1, px of level 0
  Eigen::Matrix2d A;    ///< du1 / du0 at the feature, the same on every level
  bool valid = false;   ///< in front of camera 1 and A invertible
};
PatchWarp warp_patch(const Camera& camera, const Eigen::Vector2d& uv0, double q, const SE3& T_10);

/// Finds the position in image 1 of the feature at `uv0` (px, sub-pixel) with inverse depth `q` > 0. It is inverse
/// compositional Lucas-Kanade over (du, dv, gain, bias); the template is an 8x8 patch, centred on the feature and warped
/// affinely by T_10.
///
/// `f0`, `f1`: grey pyramids of the sizes of `camera` and its levels, finest first. The position is found on `level`;
/// if that is 0, level 1 helps if it exists. All inputs are valid: a NaN gives a status, not a position. The shader
/// feature_alignment.comp has the same stages.
AlignedFeature align_feature(const Pyramid& f0, const Pyramid& f1, const Camera& camera, const Eigen::Vector2d& uv0, double q,
                             const SE3& T_10, const FeatureAlignmentOptions& options = {}, int level = 0);

/// The colour sums of a patch at `uv1`. `f0` is level 0, `rgb1` the rgb_maps() of image 1. Precondition: align_feature() has
/// aligned the patch there, with this pose.
ColourSums colour_sums(const Map& f0, std::span<const Map> rgb1, const Camera& camera, const Eigen::Vector2d& uv0, double q,
                       const SE3& T_10, const Eigen::Vector2d& uv1);

}  // namespace iclk::internal
