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
  /// px: what a perfect patch is still wrong by (interpolation, depth, rolling surface), a floor of every covariance. A first
  /// solution takes `sigma`; the residuals that it leaves say what the last one takes, within [min_sigma, max_sigma]: depth of
  /// a room's camera and of a terrain model are ten times apart. A wider one would follow what is wrong the same way in many
  /// places, such as a lens that nobody described.
  double sigma = 0.1, min_sigma = 0.01, max_sigma = 0.3;
  /// Features without an inverse_depth_sigma of their own: the largest relative one that the residuals may speak for; 0: none.
  /// A depth that is wrong displaces a feature along its epipolar line, the farther the larger the parallax.
  double max_depth_sigma = 0.03;
  /// px: standard deviation of focal length and principal point, for the covariance. Nothing: what the residuals allow for. 0:
  /// a camera that is known, as a renderer's.
  std::optional<double> camera_sigma;
  double cauchy_scale = 2.5;  ///< a residual of so many floors has half the weight
  int iterations = 50;
  int min_features = 6;           ///< fewer aligned features end in too_few_features
  double inlier_distance = 1.5;   ///< px of reprojection error; wide enough for a lens whose distortion nobody gave us
  double min_inlier_share = 0.5;  ///< a smaller share of the aligned features ends in diverged

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// What pose (and structure) refinement gives.
struct PoseResult {
  SE3 T_10;
  /// Of xi in T_10 Exp(xi), twist order [rho, phi]: (J^T W J)^-1 times the variance of the residuals as the M-estimator
  /// sees it, and `shared`. Zero unless converged or max_iterations.
  Matrix6d covariance = Matrix6d::Zero();
  Status status = Status::diverged;  ///< converged, max_iterations, too_few_features, degenerate or diverged
  std::string reason;                ///< the status in words, with the numbers that decided it
  double initial_cost = 0;           ///< mean of rho(|r|^2) / 2 over the used features, px^2, before
  double cost = 0;                   ///< and after
  double sigma = 0;                  ///< px: robust standard deviation of a residual component
  double floor = 0;                  ///< px: sigma_0 of the solution
  double depth_sigma = 0;            ///< relative, of inverse depths without a sigma of their own
  double calibration_sigma = 0;      ///< px: PoseOptions::camera_sigma, as given or as far as the residuals allow for an error
  Matrix6d shared = Matrix6d::Zero();  ///< the part of `covariance` that is of errors which all features share
  int used = 0, inliers = 0, iterations = 0;

  bool converged() const { return status == Status::converged; }
};

/// d u1 / d xi of u1 = project(X1), X1 = T_10 Exp(xi) X0 at xi = 0; twist order [rho, phi]. Precondition: (T_10 X0).z() > 0.
Eigen::Matrix<double, 2, 6> reprojection_jacobian(const Camera& camera, const SE3& T_10, const Eigen::Vector3d& X0);

/// The pose that projects the features onto their aligned positions: Cauchy loss, Levenberg-Marquardt (Ceres's TinySolver),
///
///   min_T sum_i rho(|W_i (project(T X_i) - uv1_i)|^2),   W_i = sigma_0 (covariance_i + sigma_0^2 I + a_i a_i^T)^-1/2
///
/// over the features whose status is aligned: a sharp patch counts its residual in px, a vague one less; a_i is what a standard
/// deviation of its depth moves it by. sigma_0, the floor, is found from the residuals, and so is the standard deviation of
/// depths that come without one: PoseOptions.
/// Preconditions: `aligned` has one entry a feature, else Error(invalid_argument); a feature that is not finite or has no depth
/// is not used.
PoseResult refine_pose(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned, const SE3& T_10,
                       const PoseOptions& options = {});

}  // namespace iclk
