#pragma once
#include <span>
#include <vector>

#include <iclk/align/se3.h>

namespace iclk {

/// Extrinsics of one moment, by one pair alone.
struct FlexMeasurement {
  double time = 0;  ///< s, later than the one before
  SE3 T_rl;
  Matrix6d covariance = Matrix6d::Zero();  ///< of xi in T_rl Exp(xi), [rho, phi]
  bool valid = false;                      ///< false: the pair gave no pose, and the moment is filled in by the motion
};

/// How a rig bends, as its user states it: standard deviations about its mean, and the highest frequency. The defaults are a
/// small wing. Motion is white acceleration whose strength is that of an oscillation of this size at this frequency; a slower
/// one passes as well, and a lower frequency smooths more.
struct FlexOptions {
  double rotation = 0.035;    ///< rad
  double translation = 0.03;  ///< in the unit of the poses
  double frequency = 8;       ///< Hz
  double cauchy_scale = 4;    ///< a measurement of so many deviations has half the weight
  int iterations = 30;

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

struct FlexState {
  double time = 0;
  SE3 T_rl;
  Matrix6d covariance = Matrix6d::Zero();
  Vector6d velocity = Vector6d::Zero();  ///< of xi in mean Exp(xi), 1 / s
};

struct FlexResult {
  bool usable = false;
  SE3 mean;  ///< T_rl about which the rig bends
  std::vector<FlexState> states;
};

/// Extrinsics over time, all measurements together (a smoother): T_k = mean Exp(xi_k), xi a Gaussian process of white
/// acceleration (constant velocity), and weakly drawn to zero by the stated deviations. Cauchy's loss on the measurements,
/// Ceres, in time that grows with their number. Unusable: no valid measurement. Throws Error(invalid_argument) for bad options,
/// times that do not grow, poses or covariances of valid measurements that are not finite or not positive.
FlexResult smooth_flex(std::span<const FlexMeasurement> measurements, const FlexOptions& options = {});

}  // namespace iclk
