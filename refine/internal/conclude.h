#pragma once
#include <iclk/refine/internal/rounds.h>

namespace iclk::internal {

/// Sets the result after the rounds: status, reason, pose, covariance and, with RefinerOptions::structure, depths.
void conclude(const View& view, const RefinerOptions& options, const Pair& pair, PoseCandidate& candidate);

/// Searches for poses that may rival an answer. `reference`: its grey map of level 0.
Elsewhere look_elsewhere(const View& view, const RefinerOptions& options, const Map& reference, const Pair& pair,
                         const PoseCandidate& answer);

}  // namespace iclk::internal
