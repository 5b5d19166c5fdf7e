#pragma once
#include <vector>

#include <iclk/refine/pose.h>

namespace iclk::internal {

struct StructureOptions {
  PoseOptions pose;
  double relative_sigma = 0.02;  ///< relative sigma of inverse depths for which Features has none

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

struct StructureResult {
  PoseResult pose;
  std::vector<double> inverse_depth;        ///< N: refined where used, else as given
  std::vector<double> inverse_depth_sigma;  ///< N: posterior where used and converged, else the prior's (0: no depth)
};

/// Refines the pose and the inverse depths of the aligned features together. To the sum of refine_pose() it adds the prior
/// (sigma_0 (q_i - q0_i) / sigma_q_i)^2 of every used feature. The depths are eliminated first (Schur complement).
StructureResult refine_structure(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                                 const SE3& T_10, const StructureOptions& options = {});

}  // namespace iclk::internal
