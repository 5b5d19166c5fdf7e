#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>

#include <Eigen/Core>

namespace iclk::internal {

inline uint32_t hash(int x, int y, uint32_t salt) {
  uint32_t h = static_cast<uint32_t>(x) * 0x9E3779B1u ^ static_cast<uint32_t>(y) * 0x85EBCA77u ^ salt * 0xC2B2AE3Du;
  h = (h ^ (h >> 15)) * 0x2C1B3C6Du;
  h = (h ^ (h >> 12)) * 0x297A2D39u;
  return h ^ (h >> 15);
}

inline double unit(int x, int y, uint32_t salt) { return hash(x, y, salt) * (1.0 / 4294967296.0); }

inline int cell_of(double x) { return static_cast<int>(std::floor(x)); }

/// Value noise in [0, 1] with cells of side 1.
inline double noise(double x, double y, uint32_t salt) {
  const int ix = cell_of(x), iy = cell_of(y);
  const auto smooth = [](double t) { return t * t * t * (t * (6 * t - 15) + 10); };
  const double a = smooth(x - ix), b = smooth(y - iy);
  const double low = unit(ix, iy, salt) * (1 - a) + unit(ix + 1, iy, salt) * a;
  const double high = unit(ix, iy + 1, salt) * (1 - a) + unit(ix + 1, iy + 1, salt) * a;
  return low * (1 - b) + high * b;
}

/// Noise of several scales, about in [0, 1]. Each scale is rotated, to hide the directions of the grid.
inline double turbulence(double x, double y, double cell, int octaves, double gain, uint32_t salt) {
  double sum = 0, weight = 1, total = 0;
  x /= cell, y /= cell;
  for (int i = 0; i < octaves; ++i, weight *= gain) {
    sum += weight * noise(x, y, salt + static_cast<uint32_t>(i));
    total += weight;
    const double turned = 2 * (0.8 * x - 0.6 * y) + 7.3;
    y = 2 * (0.6 * x + 0.8 * y) + 3.1, x = turned;
  }
  return sum / total;
}

inline double ramp(double x, double from, double to) { return std::clamp((x - from) / (to - from), 0.0, 1.0); }

inline Eigen::Vector3d mix(const Eigen::Vector3d& a, const Eigen::Vector3d& b, double t) {
  return a + std::clamp(t, 0.0, 1.0) * (b - a);
}

}  // namespace iclk::internal
