#pragma once
#include <span>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/refine/refiner.h>

namespace iclk::internal {

/// Poses on which features agree by places that look like them and that `T_10` does not explain: one tile further, the
/// background behind what moves, the scene behind a caption. At most `most`, those with the most features first. Patches are
/// compared as `T_10` warps them. `reference`: of level 0; an empty map has no rivals.
std::vector<SE3> find_rivals(const Map& reference, const Pair& pair, const Camera& camera, const Features& features,
                             std::span<const FeatureCheck> checks, const SE3& T_10, int most);

/// What two poses of one pair have for themselves: inliers that the other pose shows too, and does not explain as well.
struct Contest {
  int first = 0, second = 0;
};
Contest compare(const Camera& camera, const Features& features, const RefinedAlignment& first, const RefinedAlignment& second,
                  double inlier_distance);

/// Inliers of a pose, one flag a feature.
std::vector<bool> inliers(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                          const SE3& T_10, double inlier_distance);

/// How many of the features that `agree` are where the reference has them, to a tenth of a pixel.
int count_still(const Features& features, std::span<const AlignedFeature> aligned, const std::vector<bool>& agree);

}  // namespace iclk::internal
