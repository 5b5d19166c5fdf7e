#pragma once
#include <optional>

#include <iclk/align/camera.h>
#include <iclk/align/pyramid.h>
#include <iclk/align/se3.h>
#include <iclk/refine/internal/align_feature.h>

namespace iclk::internal {

/// Finds feature `uv0` of image 0, with an inverse depth in [low, high], in image 1. It takes the patch with the best
/// correlation along the epipolar line, and then align_feature() for sub-pixel accuracy. Nothing if the middle of the line is
/// outside the image, or the line is too long. Nothing, too, if no place or more than one looks like the feature. `f0`, `f1`:
/// grey pyramids with hidden pixels (hide()). Precondition: 0 < low <= high.
std::optional<AlignedFeature> search_epipolar(const Pyramid& f0, const Pyramid& f1, const Camera& camera,
                                              const Eigen::Vector2d& uv0, double low, double high, const SE3& T_10);

}  // namespace iclk::internal
