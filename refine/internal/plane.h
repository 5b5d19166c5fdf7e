#pragma once
#include <span>

#include <iclk/align/features.h>
#include <iclk/refine/feature_alignment.h>

namespace iclk::internal {

/// The number of aligned features that the best homography maps to within `inlier_distance` px of their positions: a plane
/// explains these without depths. Deterministic.
int plane_inliers(const Features& features, std::span<const AlignedFeature> aligned, double inlier_distance);

}  // namespace iclk::internal
