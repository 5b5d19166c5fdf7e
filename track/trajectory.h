#pragma once
#include <span>
#include <vector>

#include <iclk/align/se3.h>

namespace iclk {

/// An estimated pose and the true pose at the same time.
struct PosePair {
  SE3 estimate, truth;  ///< T_WC, each in its own world frame
};

/// Absolute trajectory error: the distances of the positions after the best rigid alignment (Umeyama, without scale), as
/// `evo_ape -a` computes it. Zero for fewer than three pairs.
struct TrajectoryError {
  double rmse = 0, median = 0, max = 0;  ///< in the unit of the poses
  SE3 alignment;                         ///< world of the estimate to world of the truth
};
TrajectoryError absolute_error(std::span<const PosePair> pairs);

/// Relative error of the motion over `delta` poses: root mean square over all starts, as
/// `evo_rpe --delta_unit f --all_pairs` computes it.
struct RelativeError {
  double translation = 0, rotation = 0;  ///< in the unit of the poses; rad
  int count = 0;                         ///< of motions
};
RelativeError relative_error(std::span<const PosePair> pairs, int delta);

/// The length of the true path: the sum of the distances between successive positions.
double way_length(std::span<const PosePair> pairs);

}  // namespace iclk
