#pragma once
#include <span>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/se3.h>

namespace iclk {

/// A feature of a left image, seen in the right image that was taken with it. All in px of the undistorted images.
struct RigSighting {
  int pair = 0;                                          ///< 0 .. pairs - 1: errors of one pair may be alike
  Eigen::Vector2d left, right;                           ///< px
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();  ///< px^2, of `right`
  double inverse_depth = 0, inverse_depth_sigma = 0;     ///< in the left camera; sigma 0: where the search begins, no more
};

struct RigAdjustOptions {
  double floor = 0.1, min_floor = 0.01, max_floor = 1;  ///< px: what positions are off by beyond their covariances; first guess
  double cauchy_scale = 2.5;                            ///< a residual of so many floors has half the weight
  double inlier_distance = 1.5;                         ///< px
  int iterations = 50;
  double baseline = 0, baseline_sigma = 0;  ///< prior on the length of t; sigma 0: none

  /// Errors that all features share do not average out, and are allowed for in the covariance alone (consider parameters):
  double shared_position = 0.02;  ///< px, of all positions in the right image, each way: principal points, patches on slopes
  double shared_depth = 0.5;      ///< of the deviations of the inverse depths: so much of them is common to all

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

struct RigAdjustment {
  bool usable = false;
  SE3 T_rl;
  Matrix6d covariance = Matrix6d::Zero();  ///< of xi in T_rl Exp(xi), [rho, phi]
  double sigma = 0;                        ///< px, across the epipolar lines, where no error of a depth shows
  double inflation = 1;                    ///< what the covariance was multiplied by because pairs differ more than features do
  std::vector<double> inverse_depth;       ///< one a sighting
  std::vector<double> residual;            ///< px, one a sighting; infinite behind a camera
  int used = 0, inliers = 0, iterations = 0;
};

/// One T_rl and all inverse depths together:
///
///   min sum rho(|W (project_r(R ray_l + q t) - uv_r)|^2) + sum ((q - q0) / sigma_q)^2 + ((|t| - baseline) / baseline_sigma)^2
///
/// The floor of W is found from the residuals across the epipolar lines. The covariance is the sandwich of the M-estimator, by
/// features, and multiplied where the sums over pairs scatter more than the features' scores allow; shared errors are added.
/// Unusable: fewer than 8 sightings in front of both cameras, or they do not determine T_rl (with unknown depths and no prior,
/// its length). Throws Error(invalid_argument) for bad options, cameras, a start that is not finite, pair < 0.
RigAdjustment adjust_rig(const Camera& left, const Camera& right, std::span<const RigSighting> sightings, const SE3& T_rl,
                         const RigAdjustOptions& options = {});

/// Difference of the rows, px, that a correspondence has after rectification by T_rl with the left camera's focal length; what
/// a dense stereo matcher suffers from. NaN where a ray points away from the rectified view.
double rectified_error(const Camera& left, const Camera& right, const SE3& T_rl, const Eigen::Vector2d& uv_left,
                       const Eigen::Vector2d& uv_right);

/// Rotations of both cameras into the common rectified frame: x along the baseline from left to right, z as near the mean of
/// both optical axes as that allows. Precondition: t is not zero.
struct Rectification {
  Eigen::Matrix3d left, right;  ///< left or right camera -> rectified
};
Rectification rectify(const SE3& T_rl);

}  // namespace iclk
