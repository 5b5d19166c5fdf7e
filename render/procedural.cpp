#include <iclk/render/procedural.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <string>

#include <iclk/align/common/each.h>
#include <iclk/engine/error.h>
#include <iclk/render/internal/landscape.h>
#include <iclk/render/internal/shadows.h>

namespace iclk {

using Eigen::Vector3d;

void ProceduralOptions::check() const {
  const auto fail = [](const std::string& why) { throw Error(ErrorCode::invalid_argument, "procedural terrain: " + why); };
  if (!(relief_step > 0) || !(mosaic_step > 0) || !(size >= 4 * std::max(relief_step, mosaic_step)))
    fail("a size of " + std::to_string(size) + " m, heights " + std::to_string(relief_step) + " m and texels " +
         std::to_string(mosaic_step) + " m apart: steps must be positive and the size at least four of them");
  if (!(size / mosaic_step <= 65536) || !(size / relief_step <= 65536))
    fail("a size of " + std::to_string(size) + " m has more than 65536 steps; use longer steps");
  if (!(relief >= 0 && relief <= 5000)) fail("a relief of " + std::to_string(relief) + " m must be 0 to 5000");
  if (date) date->check();
}

Terrain procedural_terrain(const ProceduralOptions& options) {
  options.check();
  const internal::Landscape landscape(options.seed, options.relief, options.date);
  const auto grid = [&](double step) {
    const int n = static_cast<int>(std::lround(options.size / step));
    return Grid{n, n, 0, n * step, step, step};
  };
  Terrain terrain;
  terrain.mosaic = grid(options.mosaic_step);
  terrain.relief = grid(options.relief_step);
  // One step beyond the mosaic on every side, so that there is ground below all of it.
  terrain.relief.left -= options.relief_step, terrain.relief.top += options.relief_step;
  terrain.relief.width += 2, terrain.relief.height += 2;

  const Grid& r = terrain.relief;
  terrain.height.resize(static_cast<size_t>(r.width) * static_cast<size_t>(r.height));
  internal::for_each_of(static_cast<size_t>(r.height), options.threads, [&](size_t row) {
    const int v = static_cast<int>(row);
    for (int u = 0; u < r.width; ++u)
      terrain.height[static_cast<size_t>(v) * static_cast<size_t>(r.width) + static_cast<size_t>(u)] =
          static_cast<float>(landscape.surface(r.left + (u + 0.5) * r.step_x, r.top - (v + 0.5) * r.step_y));
  });

  const Grid& m = terrain.mosaic;
  terrain.rgba.resize(static_cast<size_t>(m.width) * static_cast<size_t>(m.height));
  std::optional<internal::Shadows> shadows;
  if (options.date) shadows.emplace(terrain, landscape.sun(), options.threads);
  internal::for_each_of(static_cast<size_t>(m.height), options.threads, [&](size_t row) {
    const int v = static_cast<int>(row);
    for (int u = 0; u < m.width; ++u) {
      const double x = m.left + (u + 0.5) * m.step_x, y = m.top - (v + 0.5) * m.step_y, d = r.step_x;
      const auto h = [&](double dx, double dy) { return terrain.height_at(x + dx, y + dy).value_or(0); };
      const Vector3d normal = Vector3d((h(-d, 0) - h(d, 0)) / (2 * d), (h(0, -d) - h(0, d)) / (2 * d), 1).normalized();
      const Vector3d c = landscape.colour(x, y, normal, shadows ? shadows->sunlit(x, y) : 1);
      uint32_t p = 0xff000000u;
      for (int i = 0; i < 3; ++i) p |= static_cast<uint32_t>(std::clamp(c[i] + 0.5, 0.0, 255.0)) << (8 * i);
      terrain.rgba[static_cast<size_t>(v) * static_cast<size_t>(m.width) + static_cast<size_t>(u)] = p;
    }
  });
  return terrain;
}

}  // namespace iclk
