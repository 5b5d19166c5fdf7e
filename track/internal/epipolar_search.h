#pragma once
#include <optional>

#include <iclk/align/camera.h>
#include <iclk/align/pyramid.h>
#include <iclk/align/se3.h>
#include <iclk/refine/internal/align_feature.h>

namespace iclk::internal {

/// Feature `uv0` of image 0, whose inverse depth lies within [low, high], in image 1: the patch that correlates best along the
/// epipolar line, then align_feature(), sub-pixel. Nothing where the line leaves the image in its middle or is too long, where
/// no place looks like the feature, or two do. `f0`, `f1`: grey pyramids, hidden pixels marked (hide()).
/// Precondition: 0 < low <= high.
std::optional<AlignedFeature> search_epipolar(const Pyramid& f0, const Pyramid& f1, const Camera& camera,
                                              const Eigen::Vector2d& uv0, double low, double high, const SE3& T_10);

}  // namespace iclk::internal
