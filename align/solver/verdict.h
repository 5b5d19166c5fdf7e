#pragma once
#include <span>

#include <iclk/align/aligner.h>
#include <iclk/align/options.h>
#include <iclk/align/solver/agreement.h>
#include <iclk/align/solver/normal_equations.h>

namespace iclk::internal {

/// What any solver knows of a pair when its iterations are over, in the finest level's units.
struct Ending {
  Point point;
  NormalSums sums;        ///< at `point`
  Agreement agreement;    ///< at `point`
  bool singular = false;  ///< the last system had no solution
  double last_step = 0;   ///< px
  Camera camera;          ///< of level 0
  double mean_inverse_depth = 0;
  const PosePrior* prior = nullptr;  ///< or null
  double repeats = 0;                ///< share of the features that look the same elsewhere in the target
};

/// Fills pose, H, covariance, cost, correlation, visible fraction, gain, bias, status and reason of `alignment` from an ending:
/// the one place where an alignment is judged, for every solver.
void conclude(const Ending& ending, const AlignerOptions& options, Alignment& alignment);

/// A pair whose last step at the finest level was longer than this (px) has not come to rest.
double still_moving(const AlignerOptions& options);

/// False if so few features (in dense mode: pixels with depth) are usable that no alignment should be tried.
bool enough_to_align(std::span<const FeatureCheck> checks, double mean_inverse_depth, const Plan& plan,
                     const AlignerOptions& options);

/// The verdict on such a pair.
Alignment too_few_features(const std::vector<FeatureCheck>& checks, const SE3& T_10, const AlignerOptions& options);

}  // namespace iclk::internal
