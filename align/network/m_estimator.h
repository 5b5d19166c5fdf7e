#pragma once
#include <vector>

#include <iclk/align/network/network.h>
#include <iclk/align/solver/normal_equations.h>

namespace iclk::internal {

/// Applies the layers of the M-estimator to its four channels, then a sigmoid and the mask `visible` (0 or 1). It computes only
/// the neighbourhoods of visible pixels.
Map m_estimator(const Model& model, const Planes& in, const Map& visible);

/// Resizes a map bilinearly by pixel areas, with repeated borders: u_in = (u + 0.5) in.width / width - 0.5.
Map resized(const Map& in, int width, int height);

/// The M-estimator's weight of each element at the start of a level; 0 if it is not visible. `weight` is the map of the next
/// coarser level, or empty; it is replaced by that of this level.
std::vector<float> m_estimator_weights(const Model& model, const Template& pixels, const Map& f1, const Camera& level_camera,
                                       const Point& at, Map& weight);

}  // namespace iclk::internal
