#include <iclk/render/internal/levels.h>

#include <algorithm>
#include <cmath>

#include <iclk/shaders/render/render.h>

namespace iclk {
namespace {

constexpr float kHole = static_cast<float>(ICLK_RENDER_HOLE);

template <typename T>
RasterLevel<T> level_of(int width, int height) {
  return {width, height, std::vector<T>(static_cast<size_t>(width) * static_cast<size_t>(height))};
}

/// The mean of four texels. Halves are alternately rounded up and down, so that coarse levels are not brighter than the finest.
uint32_t mean(const uint32_t (&texels)[4], uint32_t round) {
  uint32_t sum[3] = {}, alpha = 0;
  for (const uint32_t p : texels) {
    const uint32_t a = p >> 24;
    for (int c = 0; c < 3; ++c) sum[c] += (p >> (8 * c) & 255) * a;
    alpha += a;
  }
  if (alpha == 0) return 0;
  uint32_t out = (alpha + 1 + round) / 4 << 24;
  for (int c = 0; c < 3; ++c) out |= std::min<uint32_t>((sum[c] + alpha / 2 - (round ? 0 : alpha / 4)) / alpha, 255) << (8 * c);
  return out;
}

template <typename T>
void reduce(const RasterLevel<T>& fine, RasterLevel<T>& coarse, const T* data, auto&& combine) {
  for (int v = 0; v < coarse.height; ++v) {
    const T* row = data + static_cast<size_t>(2 * v) * static_cast<size_t>(fine.width);
    const T* next = 2 * v + 1 < fine.height ? row + fine.width : row;
    T* out = coarse.data.data() + static_cast<size_t>(v) * static_cast<size_t>(coarse.width);
    for (int u = 0; u < coarse.width; ++u) {
      const int a = 2 * u, b = std::min(2 * u + 1, fine.width - 1);
      out[u] = combine(row[a], row[b], next[a], next[b], static_cast<uint32_t>((u ^ v) & 1));
    }
  }
}

}  // namespace

std::vector<RasterLevel<uint32_t>> mosaic_levels(const Grid& grid, const std::vector<uint32_t>& rgba) {
  std::vector<RasterLevel<uint32_t>> levels(1);
  levels[0].width = grid.width, levels[0].height = grid.height;
  while (levels.back().width > 1 || levels.back().height > 1) {
    const size_t fine = levels.size() - 1;
    levels.push_back(level_of<uint32_t>((levels[fine].width + 1) / 2, (levels[fine].height + 1) / 2));
    reduce(levels[fine], levels.back(), fine == 0 ? rgba.data() : levels[fine].data.data(),
           [](uint32_t a, uint32_t b, uint32_t c, uint32_t d, uint32_t round) {
             return mean({a, b, c, d}, round);
           });
  }
  return levels;
}

std::vector<RasterLevel<float>> relief_levels(const Grid& grid, const std::vector<float>& height) {
  std::vector<RasterLevel<float>> levels(1);
  levels[0].width = grid.width, levels[0].height = grid.height;
  levels.push_back(level_of<float>(grid.width - 1, grid.height - 1));
  for (int v = 0; v + 1 < grid.height; ++v) {
    const float* row = height.data() + static_cast<size_t>(v) * static_cast<size_t>(grid.width);
    const float* next = row + grid.width;
    float* out = levels[1].data.data() + static_cast<size_t>(v) * static_cast<size_t>(grid.width - 1);
    for (int u = 0; u + 1 < grid.width; ++u) {
      const bool hole = std::isnan(row[u]) || std::isnan(row[u + 1]) || std::isnan(next[u]) || std::isnan(next[u + 1]);
      out[u] = hole ? kHole : std::max({row[u], row[u + 1], next[u], next[u + 1]});
    }
  }
  while (levels.back().width > 1 || levels.back().height > 1) {
    const size_t fine = levels.size() - 1;
    levels.push_back(level_of<float>((levels[fine].width + 1) / 2, (levels[fine].height + 1) / 2));
    reduce(levels[fine], levels.back(), levels[fine].data.data(), [](float a, float b, float c, float d, uint32_t) {
      return std::max({a, b, c, d});
    });
  }
  return levels;
}

}  // namespace iclk
