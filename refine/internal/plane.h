#pragma once
#include <span>

#include <iclk/align/features.h>
#include <iclk/refine/feature_alignment.h>

namespace iclk::internal {

/// Number of aligned features that one homography puts within `inlier_distance` px of where they were found: what a plane
/// explains without any depth. Deterministic.
int plane_inliers(const Features& features, std::span<const AlignedFeature> aligned, double inlier_distance);

}  // namespace iclk::internal
