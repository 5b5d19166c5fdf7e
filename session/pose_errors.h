#pragma once
#include <span>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/align/se3.h>
#include <iclk/refine/feature_alignment.h>

namespace iclk {

/// The error of a pose; the stage errors of the JSON contract.
struct PoseError {
  double e_pixel = 0;   ///< px, mean distance between estimated and true positions of the features in image 1; NaN: no feature
  double e_transl = 0;  ///< |t - t_true| of T_10, in the scene's unit
  double e_rot = 0;     ///< rad, angle of R R_true^T
};

/// Uses the features with depth that both poses place in front of camera 1, inside or outside image 1.
PoseError pose_error(const Camera& camera, const Features& features, const SE3& T_10, const SE3& T_10_true);

/// The mean distance of aligned positions from the true projections, px.
double aligned_error(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                     const SE3& T_10_true);

/// Sets uv1 to the projection of feature i into image 1. Returns false if it has no depth or lies behind camera 1.
bool project_feature(const Camera& camera, const Features& features, int i, const SE3& T_10, Eigen::Vector2d& uv1);

}  // namespace iclk
