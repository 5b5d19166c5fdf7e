#pragma once
#include <span>
#include <vector>

#include <iclk/align/se3.h>

namespace iclk {

/// A pose that was estimated, and the true one of that time.
struct PosePair {
  SE3 estimate, truth;  ///< T_WC, each in a world of its own
};

/// Absolute trajectory error: distances of the positions after the rigid motion that brings them closest (Umeyama, without
/// scale), as evo_ape -a has it. Zero for fewer than three pairs.
struct TrajectoryError {
  double rmse = 0, median = 0, max = 0;
  SE3 alignment;  ///< truth's world from the estimate's
};
TrajectoryError absolute_error(std::span<const PosePair> pairs);

/// Relative error of the motion over `delta` poses, root mean square, every start: translation in the unit of the poses,
/// rotation in rad, as evo_rpe --delta_unit f --all_pairs has it.
struct RelativeError {
  double translation = 0, rotation = 0;
  int count = 0;
};
RelativeError relative_error(std::span<const PosePair> pairs, int delta);

/// Sum of the distances from one true position to the next.
double way_length(std::span<const PosePair> pairs);

}  // namespace iclk
