#pragma once
#include <span>
#include <vector>

#include <iclk/align/features.h>
#include <iclk/align/pyramid.h>

namespace iclk::internal {

/// Mask and inverse depth of one level, one float a patch pixel: entry feature * 64 + 8 row + column is the feature's inverse
/// depth where that pixel belongs to it, 0 elsewhere. A pixel in several patches belongs to the nearest feature, on a tie to
/// the lower index; a pixel outside the image, or of a feature that is not ok, to nobody.
std::vector<float> sparse_mask(const Features& features, std::span<const FeatureCheck> checks, const Camera& camera, int level);

/// The same for dense mode, from the inverse depth of the next finer level: the mean of the valid ones of a 2x2 block, 0 where
/// none is valid or where they differ by more than a tenth: across an occlusion edge a mean is no surface.
Map half_inverse_depth(const Map& finer);

}  // namespace iclk::internal
