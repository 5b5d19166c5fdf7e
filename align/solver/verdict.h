#pragma once
#include <span>

#include <iclk/align/aligner.h>
#include <iclk/align/options.h>
#include <iclk/align/solver/agreement.h>
#include <iclk/align/solver/normal_equations.h>

namespace iclk::internal {

/// The state of a pair after its iterations, from any solver, in units of the finest level.
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

/// Judges an alignment of any solver: fills pose, H, covariance, cost, correlation, visible fraction, gain, bias, status and
/// reason.
void conclude(const Ending& ending, const AlignerOptions& options, Alignment& alignment);

/// If the last step at the finest level is longer than this (px), the pair has not converged.
double still_moving(const AlignerOptions& options);

/// Whether there are enough usable features (in dense mode: pixels with depth) to try an alignment.
bool enough_to_align(std::span<const FeatureCheck> checks, double mean_inverse_depth, const Plan& plan,
                     const AlignerOptions& options);

/// The result of a pair with too few.
Alignment too_few_features(const std::vector<FeatureCheck>& checks, const SE3& T_10, const AlignerOptions& options);

}  // namespace iclk::internal
