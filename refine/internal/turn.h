#pragma once
#include <optional>
#include <span>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/align/se3.h>
#include <iclk/refine/feature_alignment.h>
#include <iclk/refine/rolling_shutter.h>

namespace iclk::internal {

/// A feature of a reference and its position in a target.
struct RollingSighting {
  Eigen::Vector2d uv0, uv1;
  double inverse_depth = 0;
  double inverse_depth_sigma = 0;  ///< it reduces the weight along the epipolar line
};

/// The rotation of a camera while its rows were read. It bends the image in a way that no pose explains.
struct TurnEstimate {
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();  ///< rad, in the axes of the camera, beyond the turn that was corrected
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  SE3 T_10;                                 ///< estimated together with the turn
  Matrix6d pose_share = Matrix6d::Zero();   ///< the part of the covariance of T_10 from the turn's uncertainty, [rho, phi]
  double chi2() const;                      ///< of the turn against no turn, 3 degrees of freedom
  double bend(const Camera& camera) const;  ///< the largest motion of a pixel of the first or last row by the turn, px
  bool proven(const Camera& camera) const;  ///< chi2() above 50 and bend() above 0.5 px
  /// The probability that the camera turned. A priori it turned or not with equal probability; the sigma of turns is 0.01 rad
  /// per axis.
  double probability() const;
  /// The covariance that an unproven turn adds to `straight`, the pose estimated without it. With probability() the truth is
  /// T_10, with the uncertainty pose_share.
  Matrix6d doubt(const SE3& straight) const;
};
/// Estimates pose and turn together, by robust least squares that start at T_10. `rows`: of both images. `turn_0`: of the
/// reference, rad. `sigma`: of the positions, px. `prior_sigma`: of the turn around zero, rad per axis. Nothing if there are
/// too few sightings.
std::optional<TurnEstimate> estimate_turn(const Camera& camera, const RowTimes& rows, const SE3& T_10,
                                          const Eigen::Vector3d& turn_0, std::span<const RollingSighting> sightings,
                                          double sigma, double prior_sigma);

/// Estimates the turn of a pair's target minus that of its reference, from the aligned features and the scatter of their
/// residuals. Nothing if there are too few. A bend that both images share is not detected, and it does not affect the pose.
/// Preconditions: those of refine_pose().
std::optional<TurnEstimate> pair_turn(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                                      const SE3& T_10);

/// Corrects uv for a camera that turned by `turn` while its rows were read: the position with a global shutter.
/// Precondition: a turn below one radian.
Eigen::Vector2d unrolled(const Camera& camera, const Eigen::Vector3d& turn, const Eigen::Vector2d& uv);

}  // namespace iclk::internal
