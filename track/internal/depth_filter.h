#pragma once
#include <optional>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/se3.h>

namespace iclk::internal {

/// What one frame says of a feature's inverse depth.
struct DepthSighting {
  double inverse_depth = 0;
  double sigma = 0;     ///< standard deviation, of the position's noise and the pose's
  double off_line = 0;  ///< distance from the epipolar line, in standard deviations
};

/// The inverse depth q of the feature at `uv0` that is seen at `uv1`, px, from where T_10 says:
///
///   min_q r^T S^-1 r,  r = uv1 - project(R ray(uv0) + q t),  S = covariance + J_xi C J_xi^T,  sigma^2 = 1 / (J_q^T S^-1 J_q)
///
/// with J_q = d project / d q, and J_xi of the pose, whose covariance C is [rho, phi] of T_10 Exp(xi). Nothing where the camera
/// did not move across the ray, where the point would lie behind a camera, or for what is not finite. q may be <= 0: beyond
/// infinity, by noise. Precondition: `covariance`, px^2, is positive definite.
std::optional<DepthSighting> triangulate(const Camera& camera, const Eigen::Vector2d& uv0, const SE3& T_10,
                                         const Eigen::Vector2d& uv1, const Eigen::Matrix2d& covariance,
                                         const Matrix6d& pose_covariance = Matrix6d::Zero());

/// The same without noise: q of r + q t on the ray, by least squares.
double inverse_depth_at(const Eigen::Vector3d& r, const Eigen::Vector3d& t, const Eigen::Vector3d& ray1);

/// px per unit of inverse depth: how far the feature moves in image 1 with its inverse depth, |J_q|; 0 behind the camera.
double parallax(const Camera& camera, const Eigen::Vector2d& uv0, double q, const SE3& T_10);

/// An inverse depth and how much the sightings of it are worth, frame after frame (Vogiatzis and Hernandez 2011; SVO). A
/// sighting x is right with probability pi, else it may be anywhere:
///
///   p(x | q, pi) = pi N(x; q, sigma_x^2) + (1 - pi) U(x; range),   p(q, pi) = N(q; mean, sigma^2) Beta(pi; a, b)
///
/// A product of these keeps its form when the moments of q and pi are matched. Constant memory and time a sighting.
struct DepthFilter {
  double mean = 0, sigma = 0;  ///< of q, 1 / unit of length
  double a = 5, b = 5;         ///< counts of right and wrong sightings
  double range = 1;            ///< of q that wrong sightings scatter over

  /// Of a feature of which nothing is known but that it lies between. Precondition: 0 <= low < high.
  static DepthFilter between(double low, double high);

  /// Precondition: finite, sigma > 0.
  void add(double inverse_depth, double sigma_x);
  void add(const DepthSighting& sighting) { add(sighting.inverse_depth, sighting.sigma); }
  /// It should have been seen, and was not.
  void miss() { b += 1; }
  double inlier_share() const { return a / (a + b); }
};

}  // namespace iclk::internal
