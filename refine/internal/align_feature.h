#pragma once
#include <span>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/pyramid.h>
#include <iclk/align/se3.h>
#include <iclk/refine/feature_alignment.h>
#include <iclk/refine/internal/recolour.h>

namespace iclk::internal {

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

}  // namespace iclk::internal
