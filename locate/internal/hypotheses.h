#pragma once
#include <vector>

#include <iclk/locate/locator.h>

namespace iclk::internal {

/// Poses that cover `reach` sigmas of the prior, the likeliest first. From one of them any pose in this range is within reach
/// of the start search: half of the picture in common, less than 29 degrees of roll, little change of scale. `distance`: m from
/// the camera of the prior to the ground along its optical axis. Throws Error(invalid_argument) for more than 20000 poses.
std::vector<SE3> hypotheses(const LocatePrior& prior, const Camera& camera, double distance, double reach);

/// Whether the prior allows a pose: its attitude, and position, height and optical axis within `reach` sigmas, and 10 % of the
/// height above ground and 5 degrees more, which a rough pose may be off.
bool likely(const SE3& T_WC, const LocatePrior& prior, double distance, double reach);

/// Whether the prior allows the attitude of a pose: `reach` sigmas, and 29 degrees more, the step between headings.
bool likely_attitude(const SE3& T_WC, const LocatePrior& prior, double reach);

}  // namespace iclk::internal
