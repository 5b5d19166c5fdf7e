#pragma once
#include <vector>

#include <iclk/align/network/network.h>
#include <iclk/align/solver/normal_equations.h>

namespace iclk::internal {

/// Layers of the M-estimator on its four channels, then a sigmoid, times `visible` (0 or 1): computed only around the visible
/// pixels.
Map m_estimator(const Model& model, const Planes& in, const Map& visible);

/// Bilinear in pixel areas, borders repeated: u_in = (u + 0.5) in.width / width - 0.5.
Map resized(const Map& in, int width, int height);

/// The M-estimator's weight of each element at the start of a level, 0 where it is not visible. `weight` is the map of the
/// next coarser level, empty where there is none, and becomes that of this level.
std::vector<float> m_estimator_weights(const Model& model, const Template& pixels, const Map& f1, const Camera& level_camera,
                                       const Point& at, Map& weight);

}  // namespace iclk::internal
