#pragma once
#include <vector>

#include <iclk/locate/locator.h>

namespace iclk::internal {

/// Poses that cover `reach` sigmas of the prior, the likeliest first. From one of them any pose in this range is within reach
/// of the start search: half of the picture in common, less than 29 degrees of roll, little change of scale. `distance`: m from
/// the camera of the prior to the ground along its optical axis. Throws Error(invalid_argument) for more than 20000 poses.
std::vector<SE3> hypotheses(const LocatePrior& prior, const Camera& camera, double distance, double reach);

}  // namespace iclk::internal
