#pragma once
#include <optional>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/se3.h>

namespace iclk::internal {

/// The measurement of a feature's inverse depth by one frame.
struct DepthSighting {
  double inverse_depth = 0;
  double sigma = 0;     ///< standard deviation from the noise of position and pose
  double off_line = 0;  ///< distance from the epipolar line, in standard deviations
};

/// Triangulates the inverse depth q of the feature at `uv0`, seen at `uv1` (px) under the pose T_10:
///
///   min_q r^T S^-1 r,  r = uv1 - project(R ray(uv0) + q t),  S = covariance + J_xi C J_xi^T,  sigma^2 = 1 / (J_q^T S^-1 J_q)
///
/// with J_q = d project / d q and J_xi = d project / d xi; C is the covariance of xi = [rho, phi] in T_10 Exp(xi). Nothing if
/// the camera did not move across the ray, if the point would lie behind a camera, or if a value is not finite. Because of
/// noise q may be 0 or negative (beyond infinity). Precondition: `covariance`, px^2, is positive definite.
std::optional<DepthSighting> triangulate(const Camera& camera, const Eigen::Vector2d& uv0, const SE3& T_10,
                                         const Eigen::Vector2d& uv1, const Eigen::Matrix2d& covariance,
                                         const Matrix6d& pose_covariance = Matrix6d::Zero());

/// The same without noise: the q with r + q t on the ray, by least squares.
double inverse_depth_at(const Eigen::Vector3d& r, const Eigen::Vector3d& t, const Eigen::Vector3d& ray1);

/// The motion of the feature in image 1 per unit of inverse depth, |J_q| in px; 0 behind the camera.
double parallax(const Camera& camera, const Eigen::Vector2d& uv0, double q, const SE3& T_10);

/// Filters the inverse depth of a feature and its inlier share from frame to frame (Vogiatzis and Hernandez 2011; SVO). A
/// sighting x is right with probability pi, else it may be anywhere:
///
///   p(x | q, pi) = pi N(x; q, sigma_x^2) + (1 - pi) U(x; range),   p(q, pi) = N(q; mean, sigma^2) Beta(pi; a, b)
///
/// Matching the moments of q and pi keeps the form of p(q, pi) after each sighting. Memory and time per sighting are constant.
struct DepthFilter {
  double mean = 0, sigma = 0;  ///< of q, 1 / unit of length
  double a = 5, b = 5;         ///< counts of right and wrong sightings
  double range = 1;            ///< the range of q over which wrong sightings scatter

  /// A filter for an unknown inverse depth between `low` and `high`. Precondition: 0 <= low < high.
  static DepthFilter between(double low, double high);

  /// Adds a sighting. Precondition: finite values, sigma_x > 0.
  void add(double inverse_depth, double sigma_x);
  void add(const DepthSighting& sighting) { add(sighting.inverse_depth, sighting.sigma); }
  /// Counts a frame that should show the feature but does not.
  void miss() { b += 1; }
  double inlier_share() const { return a / (a + b); }
};

}  // namespace iclk::internal
