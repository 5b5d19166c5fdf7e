#pragma once
#include <span>
#include <vector>

#include <iclk/align/se3.h>

namespace iclk {

/// The extrinsics at one time, from one pair.
struct FlexMeasurement {
  double time = 0;  ///< s, later than the previous one
  SE3 T_rl;
  Matrix6d covariance = Matrix6d::Zero();  ///< of xi in T_rl Exp(xi), [rho, phi]
  bool valid = false;                      ///< false: the pair gave no pose; the state is interpolated by the motion model
};

/// The motion of a flexible rig: standard deviations about its mean, and the highest frequency. The defaults suit a small wing.
/// The model is white acceleration, as strong as an oscillation of this size and frequency. It also follows slower motion; a
/// lower frequency smooths more.
struct FlexOptions {
  double rotation = 0.035;    ///< rad
  double translation = 0.03;  ///< in the unit of the poses
  double frequency = 8;       ///< Hz
  double cauchy_scale = 4;    ///< a measurement this many standard deviations off has half the weight
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
  SE3 mean;  ///< the mean T_rl
  std::vector<FlexState> states;
};

/// Smooths the extrinsics over all measurements: T_k = mean Exp(xi_k). xi is a Gaussian process with white acceleration
/// (constant velocity). It has a weak prior at zero with the standard deviations of FlexOptions. The measurements have a Cauchy
/// loss. Ceres solves it in time linear in their number. Not usable without a valid measurement. Throws Error(invalid_argument)
/// for bad options and times that do not increase. The pose of a valid measurement must be finite, its covariance finite and
/// positive; else it throws Error(invalid_argument) too.
FlexResult smooth_flex(std::span<const FlexMeasurement> measurements, const FlexOptions& options = {});

}  // namespace iclk
