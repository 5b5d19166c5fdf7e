#pragma once
#include <span>

namespace iclk::internal {

/// Sets islands of fewer than `least` pixels to 0: 4-neighbours are of one island where both are not 0 and differ by at most
/// `step`. Precondition: map.size() is a multiple of `width`.
void drop_speckles(std::span<float> map, int width, int least, float step);

}  // namespace iclk::internal
