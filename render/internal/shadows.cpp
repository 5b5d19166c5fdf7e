#include <iclk/render/internal/shadows.h>

#include <algorithm>
#include <cmath>

#include <iclk/align/common/each.h>
#include <iclk/render/internal/noise.h>

namespace iclk::internal {

Shadows::Shadows(const Terrain& terrain, const Eigen::Vector3d& to_sun, int threads) : terrain_(terrain) {
  const Grid& grid = terrain.relief;
  edge_.relief = grid;
  edge_.height.resize(terrain.height.size());
  const double level = to_sun.head<2>().norm(), rise = to_sun.z() / std::max(level, 1e-9) * grid.step_x;
  const Eigen::Vector2d step = to_sun.head<2>() / std::max(level, 1e-9) * grid.step_x;
  const double highest = *std::max_element(terrain.height.begin(), terrain.height.end());
  for_each_of(static_cast<size_t>(grid.height), threads, [&](size_t row) {
    for (int u = 0; u < grid.width; ++u) {
      double x = grid.left + (u + 0.5) * grid.step_x, y = grid.top - (static_cast<double>(row) + 0.5) * grid.step_y;
      float& edge = edge_.height[row * static_cast<size_t>(grid.width) + static_cast<size_t>(u)];
      edge = -INFINITY;
      for (double fallen = rise; edge < highest - fallen; fallen += rise) {
        const auto h = terrain.height_at(x += step.x(), y += step.y());
        if (!h) break;
        edge = std::max(edge, static_cast<float>(*h - fallen));
      }
      if (!std::isfinite(edge)) edge = -1e4f;
    }
  });
}

double Shadows::sunlit(double x, double y) const {
  const auto ground = terrain_.height_at(x, y), edge = edge_.height_at(x, y);
  return ground && edge ? ramp(*ground - *edge, -0.2, 0.2) : 1;
}

}  // namespace iclk::internal
