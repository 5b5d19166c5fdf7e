#pragma once
#include <span>
#include <vector>

#include <iclk/align/features.h>
#include <iclk/align/pyramid.h>

namespace iclk::internal {

/// Mask and inverse depth of one level, one float per patch pixel. Entry feature * 64 + 8 row + column is the inverse depth of
/// the feature if the pixel belongs to it, else 0. A pixel in several patches belongs to the nearest feature; of equally near
/// ones to the lowest index. Pixels outside the image and of unusable features belong to none.
std::vector<float> sparse_mask(const Features& features, std::span<const FeatureCheck> checks, const Camera& camera, int level);

/// The inverse depth of a level in dense mode, from that of the next finer level: the mean of the valid values of each 2x2
/// block. It is 0 if none is valid or they differ by more than a tenth: a mean across an occlusion edge is not on any surface.
Map half_inverse_depth(const Map& finer);

}  // namespace iclk::internal
