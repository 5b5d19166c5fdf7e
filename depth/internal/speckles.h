#pragma once
#include <span>

namespace iclk::internal {

/// Sets connected regions of fewer than `least` pixels to 0. Two of 4 neighbours are connected if both are not 0 and differ by
/// at most `step`. Precondition: map.size() is a multiple of `width`.
void drop_speckles(std::span<float> map, int width, int least, float step);

}  // namespace iclk::internal
