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

/// A feature of a reference, and where it was found in a target.
struct RollingSighting {
  Eigen::Vector2d uv0, uv1;
  double inverse_depth = 0;
  double inverse_depth_sigma = 0;  ///< standard deviation; along the epipolar line the sighting says less by it
};

/// How far a camera turned while its rows were read, by how that bends the image, as no pose does.
struct TurnEstimate {
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();  ///< rad, in the camera's axes, beyond what the image was unrolled with
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  SE3 T_10;                                 ///< found with it
  Matrix6d pose_share = Matrix6d::Zero();   ///< what the turn's uncertainty adds to the covariance of T_10, [rho, phi]
  double chi2() const;                      ///< of the turn against none: 3 degrees of freedom
  double bend(const Camera& camera) const;  ///< px: how far the turn moves a pixel of the first or the last row, at most
  bool proven(const Camera& camera) const;  ///< chi2() above 50 and bend() above 0.5 px
  /// That the camera turned, against that it did not: both as likely before, turns of 0.01 rad an axis expected.
  double probability() const;
  /// What a turn that is not proven adds to the covariance of `straight`, the pose found without it: with probability() the
  /// truth is T_10, as uncertain as pose_share.
  Matrix6d doubt(const SE3& straight) const;
};
/// Pose and turn together, by robust least squares about T_10. `rows`: of both images. `turn_0`: the reference's own, rad.
/// `sigma`: px, of the positions; `prior_sigma`: rad, of the turn about zero, an axis. Nothing where the sightings are too few.
std::optional<TurnEstimate> estimate_turn(const Camera& camera, const RowTimes& rows, const SE3& T_10,
                                          const Eigen::Vector3d& turn_0, std::span<const RollingSighting> sightings,
                                          double sigma, double prior_sigma);

/// The turn of a pair's target in relation to its reference's, from the aligned features and the scatter that their residuals
/// have; nothing where they are too few. That both images are bent alike is not seen and does no harm. Preconditions as of
/// refine_pose().
std::optional<TurnEstimate> pair_turn(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                                      const SE3& T_10);

/// Where a camera that turned by `turn` while its rows were read would have seen uv, had it read all at once.
/// Precondition: a turn below a radian.
Eigen::Vector2d unrolled(const Camera& camera, const Eigen::Vector3d& turn, const Eigen::Vector2d& uv);

}  // namespace iclk::internal
