#pragma once
#include <span>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/se3.h>

namespace iclk::internal {

/// What is known of the errors of a map and of features that are aligned with it.
struct MapErrors {
  double sigma = 0;   ///< px: of a feature's position
  double texel = 0;   ///< m: of the mosaic
  double height = 0;  ///< m between heights
};

/// The covariance of xi in T_WC Exp(xi) from errors of the map. `points`: of the ground that features show, in the camera's
/// frame, m. Zero if they do not determine the pose.
///
/// Pixels and heights of a map are off, and so are all features near each other: the picture has 16 errors that are
/// independent, however many features it has. Each is `sigma` and what a height that is a tenth of a step off does to the
/// position. In addition, the whole ground is 0.3 texels off sidewards, and a tenth of a step of the heights up or down.
Matrix6d map_covariance(const Camera& camera, std::span<const Eigen::Vector3d> points, const Eigen::Matrix3d& R_WC,
                        const MapErrors& errors);

}  // namespace iclk::internal
