#pragma once
#include <span>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/se3.h>

namespace iclk {

/// A feature of a left image and its position in the right image of the same pair. Pixels of the undistorted images.
struct RigSighting {
  int pair = 0;                                          ///< 0 .. pairs - 1; errors within a pair may be correlated
  Eigen::Vector2d left, right;                           ///< px
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();  ///< px^2, of `right`
  double inverse_depth = 0, inverse_depth_sigma = 0;     ///< in the left camera; sigma 0: inverse_depth is only a first guess
};

struct RigAdjustOptions {
  /// The error of positions beyond their covariances, px: first guess and range; it is estimated from the residuals.
  double floor = 0.1, min_floor = 0.01, max_floor = 1;
  double cauchy_scale = 2.5;     ///< a residual of this many floors has half the weight
  double inlier_distance = 1.5;  ///< px
  int iterations = 50;
  double baseline = 0, baseline_sigma = 0;  ///< prior on the length of t; sigma 0: none

  // Errors that all features share do not average out. They enter only the covariance (consider parameters).
  double shared_position = 0.02;  ///< px, of all positions in the right image, in u and in v: principal points, slanted patches
  double shared_depth = 0.5;      ///< the share of the inverse depths' sigmas that is common to all features

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

struct RigAdjustment {
  bool usable = false;
  SE3 T_rl;
  Matrix6d covariance = Matrix6d::Zero();  ///< of xi in T_rl Exp(xi), [rho, phi]
  double sigma = 0;                        ///< px, across the epipolar lines, where depth errors have no effect
  double inflation = 1;                    ///< factor of the covariance for pairs that differ more than their features do
  std::vector<double> inverse_depth;       ///< one per sighting
  std::vector<double> residual;            ///< px, one per sighting; infinite behind a camera
  int used = 0, inliers = 0, iterations = 0;
};

/// Adjusts T_rl (left camera to right camera) and all inverse depths together:
///
///   min sum rho(|W (project_r(R ray_l + q t) - uv_r)|^2) + sum ((q - q0) / sigma_q)^2 + ((|t| - baseline) / baseline_sigma)^2
///
/// The floor of W is estimated from the residuals across the epipolar lines. The covariance is the sandwich estimate of the
/// M-estimator over the features. It is multiplied by RigAdjustment::inflation if the sums of scores vary more between pairs
/// than the features explain; shared errors are added.
///
/// The result is not usable if fewer than 8 sightings lie in front of both cameras, or if they do not determine T_rl. With
/// unknown depths and no prior they do not determine its length. Throws Error(invalid_argument) for bad options, bad cameras,
/// a start that is not finite, and a negative `pair`.
RigAdjustment adjust_rig(const Camera& left, const Camera& right, std::span<const RigSighting> sightings, const SE3& T_rl,
                         const RigAdjustOptions& options = {});

/// The difference of rows, px, of a correspondence after rectification by T_rl with the left camera's focal length. It is the
/// error that a dense stereo matcher sees. NaN if a ray points away from the rectified view.
double rectified_error(const Camera& left, const Camera& right, const SE3& T_rl, const Eigen::Vector2d& uv_left,
                       const Eigen::Vector2d& uv_right);

/// Rotations of both cameras into the common rectified frame: x along the baseline from left to right, z as close as possible
/// to the mean of both optical axes. Precondition: t is not zero.
struct Rectification {
  Eigen::Matrix3d left, right;  ///< left or right camera to rectified frame
};
Rectification rectify(const SE3& T_rl);

}  // namespace iclk
