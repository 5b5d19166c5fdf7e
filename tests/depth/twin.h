#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <vector>

#include <iclk/align/pyramid.h>
#include <iclk/depth/depth_options.h>

namespace iclk::test {

/// shaders/depth/census.comp in C++.
inline std::vector<uint32_t> census_of(const Map& grey) {
  std::vector<uint32_t> out;
  const auto at = [&](int u, int v) { return grey.at(std::clamp(u, 0, grey.width - 1), std::clamp(v, 0, grey.height - 1)); };
  for (int y = 0; y < grey.height; ++y)
    for (int x = 0; x < grey.width; ++x) {
      uint32_t bits = 0;
      for (int v = 0; v <= 3; ++v)
        for (int u = v == 0 ? 1 : -4; u <= 4; ++u) bits = bits << 1 | (at(x + u, y + v) > at(x - u, y - v) ? 1u : 0u);
      out.push_back(bits);
    }
  return out;
}

/// shaders/depth/cost.comp for a view that is shifted to the left by a whole number of pixels a plane, without priors.
inline std::vector<uint8_t> costs_of(const std::vector<uint32_t>& own, const std::vector<uint32_t>& other, int width,
                                     int height, int planes) {
  std::vector<uint8_t> out;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      for (int d = 0; d < planes; ++d) {
        const size_t row = static_cast<size_t>(y) * static_cast<size_t>(width);
        const int cost = x < d ? 8 : std::popcount(own[row + static_cast<size_t>(x)] ^ other[row + static_cast<size_t>(x - d)]);
        out.push_back(static_cast<uint8_t>(cost));
      }
  return out;
}

/// shaders/depth/path.comp in C++, for whole steps (du, dv).
inline std::vector<uint8_t> path_of(const std::vector<uint8_t>& costs, const Map& grey, int planes, int du, int dv,
                                    const DepthOptions& options) {
  const int width = grey.width, height = grey.height;
  std::vector<uint8_t> out(costs.size());
  for (int j = 0; j < height; ++j)
    for (int i = 0; i < width; ++i) {
      const int x = du < 0 ? width - 1 - i : i, y = dv < 0 ? height - 1 - j : j, a = x - du, b = y - dv;
      const auto first = [&](int u, int v) { return (static_cast<size_t>(v) * width + u) * planes; };
      const bool begin = a < 0 || b < 0 || a >= width || b >= height;
      uint8_t* L = &out[first(x, y)];
      const uint8_t* C = &costs[first(x, y)];
      if (begin) {
        std::copy(C, C + planes, L);
        continue;
      }
      const uint8_t* P = &out[first(a, b)];
      const int lowest = *std::min_element(P, P + planes);
      const auto level = [&](int u, int v) { return 255.0f * std::clamp(grey.at(u, v), 0.0f, 1.0f); };
      const auto loss = static_cast<int>(static_cast<float>(options.edge) * std::abs(level(x, y) - level(a, b)));
      const int p2 = std::max(options.p1 + 1, options.p2 - std::min(loss, options.p2));
      for (int d = 0; d < planes; ++d) {
        int best = std::min<int>(P[d], lowest + p2);
        if (d > 0) best = std::min(best, P[d - 1] + options.p1);
        if (d + 1 < planes) best = std::min(best, P[d + 1] + options.p1);
        L[d] = static_cast<uint8_t>(C[d] + best - lowest);
      }
    }
  return out;
}

}  // namespace iclk::test
