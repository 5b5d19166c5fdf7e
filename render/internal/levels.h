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

/// The pyramid of a mosaic. Level l + 1 has the means of 2x2 texels of level l, sizes rounded up, down to 1x1. Texel t of level
/// l covers texels 2^l t .. 2^l (t + 1) - 1 of level 0. Means are of the stored values (no gamma) of texels with data; alpha is
/// their share. Level 0 is left empty, because it is the mosaic.
std::vector<RasterLevel<uint32_t>> mosaic_levels(const Grid& grid, const std::vector<uint32_t>& rgba);

/// The pyramid of the heights. Level k + 1 has the greatest height of each square of 2^k x 2^k cells (a cell lies between four
/// heights), down to 1x1. It is ICLK_RENDER_HOLE where every cell has a corner without data. Level 0 is left empty, because it
/// is the heights.
std::vector<RasterLevel<float>> relief_levels(const Grid& grid, const std::vector<float>& height);

}  // namespace iclk
