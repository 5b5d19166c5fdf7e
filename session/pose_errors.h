#pragma once
#include <span>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/align/se3.h>
#include <iclk/refine/feature_alignment.h>

namespace iclk {

/// A pose against the truth; the stage errors of the JSON contract.
struct PoseError {
  double e_pixel = 0;   ///< px, mean distance in image 1 of the features' estimated and true positions; NaN if there is none
  double e_transl = 0;  ///< |t - t_true| of T_10, in the scene's unit
  double e_rot = 0;     ///< rad, angle of R R_true^T
};

/// Features with depth that lie in front of camera 1 by both poses count; whether they fall inside image 1 does not matter.
PoseError pose_error(const Camera& camera, const Features& features, const SE3& T_10, const SE3& T_10_true);

/// The same for aligned features: e_pixel is the mean distance of aligned positions from the true projections.
double aligned_error(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                     const SE3& T_10_true);

/// Where feature i lies in image 1; false if it has no depth or comes to lie behind camera 1.
bool project_feature(const Camera& camera, const Features& features, int i, const SE3& T_10, Eigen::Vector2d& uv1);

}  // namespace iclk
