#pragma once
#include <optional>
#include <span>

#include <iclk/refine/internal/reprojection.h>

namespace iclk::internal {

/// Errors of positions beyond their patches' covariances.
struct PositionErrors {
  double floor = 0;           ///< px, in both directions
  double relative_depth = 0;  ///< relative sigma of inverse depths without one: an error along the epipolar line
};

/// Estimates the errors by maximum likelihood over the observations within twice inlier_distance of T_10. The distribution is
/// Student's t with three degrees of freedom, whose scale is robust against a minority of wrong positions. `floor` is in
/// [min_sigma, max_sigma], `relative_depth` in [0, max_depth_sigma].
PositionErrors position_errors(const Camera& camera, std::span<const Observation> observations, const SE3& T_10,
                               const PoseOptions& options);

/// Sets W = sigma_0 (covariance + floor^2 I + sigma_z^2 a a^T)^-1/2 of all observations, with a = q du1 / dq at T_10. sigma_z
/// is the relative sigma of the observation's inverse depth.
void whiten(const Camera& camera, std::span<Observation> observations, const SE3& T_10, const PositionErrors& errors);

/// The effect of errors that all features share. The covariance of independent errors lacks it.
struct SharedErrors {
  Matrix6d covariance = Matrix6d::Zero();  ///< to be added to the covariance of the pose
  double calibration = 0;                  ///< px: the sigma of focal length and principal point that it allows for
};

/// Computes the effect of errors that do not average out over the features. Two kinds are consider parameters (Schmidt 1966):
/// the estimate does not change, and the covariance gets sigma_c^2 (dT/dc)(dT/dc)^T.
///
/// - Calibration: focal length and principal point, px. Confused conventions of pixel centres already cause half a pixel.
///   sigma_c is `camera_sigma`, or a posterior mean over zero (with half of the prior's weight) and [0.02, 2] px. The
///   likelihood is the restricted one of the residuals, which excludes the six parameters of the pose.
/// - Depth: whole depth maps may be too near or too far, which a translation hides completely. Half of the error of single
///   depths is assumed to be common.
///
/// `scale`: of the Cauchy loss, px. Precondition: the observations determine the pose.
SharedErrors shared_errors(const Camera& camera, std::span<const Observation> observations, const SE3& T_10, double scale,
                           double relative_depth, std::optional<double> camera_sigma = {});

/// The covariance of ICLK's pose from errors of the inverse depths, which its residuals cannot show. All 8x8 patches that the
/// pose projects into image 1 have equal weight. The sigma of a depth is that of its feature, else `relative_depth`; half of it
/// is common to all, as in shared_errors(). `common_sigma`: px per component, an error that all patches share. Zero if the
/// features do not determine the pose.
Matrix6d depth_covariance(const Camera& camera, const Features& features, std::span<const FeatureCheck> checks, const SE3& T_10,
                          double relative_depth, double common_sigma = 0);

/// The covariance of a pose whose features are all shifted alike in image 1, by `sigma` px in either direction. Zero if the
/// features do not determine the pose.
Matrix6d shift_covariance(const Camera& camera, const Features& features, std::span<const FeatureCheck> checks, const SE3& T_10,
                          double sigma);

}  // namespace iclk::internal
