#pragma once
#include <span>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/se3.h>
#include <iclk/render/terrain.h>

namespace iclk::internal {

/// What is known of the errors of a map and of features that are aligned with it.
struct MapErrors {
  double sigma = 0;   ///< px: of a feature's position
  double texel = 0;   ///< m: of the mosaic
  double height = 0;  ///< m between heights
  /// m, one per point: how rough the ground is, ground_roughness(); empty: picture and map agree in grey values, so their light
  /// is alike.
  std::span<const double> roughness = {};
};

/// The covariance of xi in T_WC Exp(xi) from errors of the map. `points`: of the ground that features show, in the camera's
/// frame, m. Zero if they do not determine the pose.
///
/// Pixels and heights of a map are off, and so are all features near each other: the picture has 16 errors that are
/// independent, however many features it has. Each is `sigma` and what a height that is a tenth of a step off does to the
/// position. In addition, the whole ground is 0.3 texels off sidewards, and a tenth of a step of the heights up or down.
/// Another sun moves what rough ground looks like: all points sidewards by 0.6 of their roughness, in one direction.
Matrix6d map_covariance(const Camera& camera, std::span<const Eigen::Vector3d> points, const Eigen::Matrix3d& R_WC,
                        const MapErrors& errors);

/// m: the standard deviation of the heights around (x, y) from a plane, as crowns and houses make it. Heights that are far
/// apart flatten crowns, which is corrected up to a factor of 4. 0 where hardly any heights are known.
double ground_roughness(const Terrain& terrain, double x, double y);

/// m: the standard deviation with which a pose of this covariance places what the camera sees at these points, root mean
/// square.
double ground_sigma(const Camera& camera, std::span<const Eigen::Vector3d> points, const Matrix6d& covariance);

}  // namespace iclk::internal
