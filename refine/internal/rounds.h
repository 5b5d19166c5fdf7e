#pragma once
#include <span>

#include <iclk/align/aligner.h>
#include <iclk/refine/internal/feature_aligner.h>
#include <iclk/refine/internal/rivals.h>
#include <iclk/refine/refiner.h>

namespace iclk::internal {

/// The state of a pose during the rounds.
struct PoseCandidate {
  size_t pair = 0;  ///< of the batch
  RefinedAlignment* result = nullptr;
  SE3 T_10;  ///< warps the next round
  PoseResult pose = {};
  int least = 0;  ///< with fewer inliers, there is no further round
  int level = 0;  ///< FeatureAlignmentTask::level

  /// Positions on a coarser level are less precise, so its inliers may be as many px of that level away.
  RefinerOptions options_for(RefinerOptions options) const;
};

View view_of(const Aligner& aligner, int slot);

/// Sets pose and cost of the stage `name`, and adds to its time.
void record_stage(RefinedAlignment& r, const char* name, const SE3& T_10, double cost, double ms);

/// Runs rounds of feature alignment and pose for all candidates together, until no pose changes.
void run_rounds(const Aligner& aligner, FeatureAligner& feature_aligner, const RefinerOptions& options,
                std::span<const Pair> pairs, std::span<PoseCandidate> candidates);

}  // namespace iclk::internal
