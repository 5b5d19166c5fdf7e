#pragma once
#include <optional>
#include <span>

#include <iclk/refine/internal/reprojection.h>

namespace iclk::internal {

/// What positions are off by, beyond what their patches say of themselves.
struct PositionErrors {
  double floor = 0;           ///< px, in both directions
  double relative_depth = 0;  ///< of the inverse depths that have no sigma of their own: an error along the epipolar line
};

/// Those of the greatest likelihood over the observations within twice inlier_distance of T_10: Student's t with three degrees
/// of freedom, whose scale a minority of wrong positions does not move. `floor` lies in [min_sigma, max_sigma],
/// `relative_depth` in [0, max_depth_sigma].
PositionErrors position_errors(const Camera& camera, std::span<const Observation> observations, const SE3& T_10,
                               const PoseOptions& options);

/// Sets W anew: sigma_0 (covariance + floor^2 I + sigma_z^2 a a^T)^-1/2 with a = q du1 / dq at T_10 and sigma_z the relative
/// sigma of the observation's inverse depth.
void whiten(const Camera& camera, std::span<Observation> observations, const SE3& T_10, const PositionErrors& errors);

/// What the pose's covariance lacks if the errors of the features are taken for independent.
struct SharedErrors {
  Matrix6d covariance = Matrix6d::Zero();  ///< to be added
  double calibration = 0;                  ///< px: sigma of focal length and principal point that it allows for
};

/// Errors that all features share do not average out. Two are allowed for, as consider parameters (Schmidt 1966): the
/// estimate stays as it is, and the covariance gets sigma_c^2 (dT/dc)(dT/dc)^T.
///
///   calibration  focal length and principal point, px. Half a pixel is soon lost between two conventions of a pixel's centre.
///                sigma_c is the posterior mean over [0.02, 2] px and zero (with half of the prior's weight) by the restricted
///                likelihood of the residuals, the part that six parameters of the pose cannot have taken up; or
///                `camera_sigma`.
///   depth        maps of depth are too near or too far as a whole, too, which a translation hides altogether: half of what
///                single depths are off by is taken to be common.
///
/// `scale`: of the Cauchy loss, px. Precondition: the observations determine the pose.
SharedErrors shared_errors(const Camera& camera, std::span<const Observation> observations, const SE3& T_10, double scale,
                           double relative_depth, std::optional<double> camera_sigma = {});

/// What errors of the inverse depths do to a pose that every patch of 8x8 pixels that it puts into image 1 has had the same say
/// in: the part of the covariance of ICLK's own pose that its residuals cannot show. The sigma is the feature's own, else
/// `relative_depth`; half of it is common to all, as above. `common_sigma`: px, a component, what the patches are off by
/// together, however many they are. Zero where the features do not determine the pose.
Matrix6d depth_covariance(const Camera& camera, const Features& features, std::span<const FeatureCheck> checks, const SE3& T_10,
                          double relative_depth, double common_sigma = 0);

}  // namespace iclk::internal
