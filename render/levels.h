#pragma once
#include <cstdint>
#include <vector>

#include <iclk/render/terrain.h>

namespace iclk {

/// One level of a pyramid, row-major.
template <typename T>
struct RasterLevel {
  int width = 0, height = 0;
  std::vector<T> data;
};

/// Level l + 1 is the mean of 2x2 texels of level l, sizes rounded up, down to 1x1: texel t of level l covers texels
/// 2^l t .. 2^l (t + 1) - 1 of level 0. Means are of the values as stored (no gamma), of the texels that have data; alpha is
/// the share of those. Level 0 is left empty: it is the mosaic itself.
std::vector<RasterLevel<uint32_t>> mosaic_levels(const Grid& grid, const std::vector<uint32_t>& rgba);

/// Level 0 is left empty: the heights themselves. Level k + 1 holds the greatest height of each square of 2^k x 2^k cells (a
/// cell lies between four heights), down to 1x1; ICLK_RENDER_HOLE where every cell has a corner without data.
std::vector<RasterLevel<float>> relief_levels(const Grid& grid, const std::vector<float>& height);

}  // namespace iclk
