#pragma once
#include <optional>
#include <span>
#include <string>

#include <iclk/align/alignment.h>
#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/align/se3.h>
#include <iclk/refine/feature_alignment.h>

namespace iclk {

struct PoseOptions {
  /// The floor sigma_0 of every position's standard deviation, px: the error of a perfect patch (interpolation, depth, curved
  /// surfaces). The first solution uses `sigma`. Its residuals then give the floor of the last one, within
  /// [min_sigma, max_sigma], because depth cameras and terrain models differ tenfold. A larger max_sigma would absorb
  /// systematic errors, such as an unknown lens distortion.
  double sigma = 0.1, min_sigma = 0.01, max_sigma = 0.3;
  /// For features without inverse_depth_sigma: the largest relative sigma that is estimated from the residuals; 0: none. A
  /// wrong depth moves a feature along its epipolar line, in proportion to the parallax.
  double max_depth_sigma = 0.03;
  /// The standard deviation of focal length and principal point, px, for the covariance. Empty: estimated from the residuals.
  /// 0: the camera is exact, as in a renderer.
  std::optional<double> camera_sigma;
  double cauchy_scale = 2.5;  ///< a residual of this many floors has half the weight
  int iterations = 50;
  int min_features = 6;           ///< fewer aligned features: too_few_features
  double inlier_distance = 1.5;   ///< px of reprojection error; allows for an unknown lens distortion
  double min_inlier_share = 0.5;  ///< a smaller share of the aligned features: diverged

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// The result of pose (and structure) refinement.
struct PoseResult {
  SE3 T_10;
  /// The covariance of xi in T_10 Exp(xi), xi = [rho, phi]: (J^T W J)^-1 times the variance of the residuals under the
  /// M-estimator, plus `shared`. Zero unless converged or max_iterations.
  Matrix6d covariance = Matrix6d::Zero();
  Status status = Status::diverged;    ///< converged, max_iterations, too_few_features, degenerate or diverged
  std::string reason;                  ///< explains the status, with the numbers that decided it
  double initial_cost = 0;             ///< mean of rho(|r|^2) / 2 over the used features at the start, px^2
  double cost = 0;                     ///< the same at the end
  double sigma = 0;                    ///< px: robust standard deviation of a residual component
  double floor = 0;                    ///< px: sigma_0 of the solution
  double depth_sigma = 0;              ///< relative sigma used for inverse depths without one
  double calibration_sigma = 0;        ///< px: PoseOptions::camera_sigma, as given or estimated
  Matrix6d shared = Matrix6d::Zero();  ///< the part of `covariance` from errors that all features share
  int used = 0, inliers = 0, iterations = 0;

  bool converged() const { return status == Status::converged; }
};

/// The Jacobian d u1 / d xi of u1 = project(T_10 Exp(xi) X0) at xi = 0, xi = [rho, phi]. Precondition: (T_10 X0).z() > 0.
Eigen::Matrix<double, 2, 6> reprojection_jacobian(const Camera& camera, const SE3& T_10, const Eigen::Vector3d& X0);

/// Finds the pose that projects the features onto their aligned positions, with Levenberg-Marquardt (Ceres's TinySolver):
///
///   min_T sum_i rho(|W_i (project(T X_i) - uv1_i)|^2),   W_i = sigma_0 (covariance_i + sigma_0^2 I + a_i a_i^T)^-1/2
///
/// The sum runs over the features whose status is aligned; rho is the Cauchy loss. The residuals of sharp patches are in px;
/// vague patches have less weight. a_i is the motion of the feature for one standard deviation of its depth. The floor sigma_0
/// and unknown standard deviations of depths are estimated from the residuals: see PoseOptions.
///
/// Features that are not finite or have no depth are not used. Throws Error(invalid_argument) unless `aligned` has one entry
/// per feature.
PoseResult refine_pose(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned, const SE3& T_10,
                       const PoseOptions& options = {});

}  // namespace iclk
