#pragma once
#include <cmath>
#include <functional>
#include <memory>

#include <Eigen/Geometry>

#include <iclk/render/renderer.h>

namespace iclk::test {

/// A terrain from functions of the map: `height` in metres, `colour` as rgba8.
inline Terrain make_terrain(const Grid& relief, const Grid& mosaic, const std::function<double(double, double)>& height,
                            const std::function<uint32_t(double, double)>& colour) {
  Terrain terrain;
  terrain.relief = relief;
  terrain.mosaic = mosaic;
  const auto fill = [](const Grid& grid, auto& values, const auto& of) {
    for (int v = 0; v < grid.height; ++v)
      for (int u = 0; u < grid.width; ++u)
        values.push_back(static_cast<typename std::decay_t<decltype(values)>::value_type>(
            of(grid.left + (u + 0.5) * grid.step_x, grid.top - (v + 0.5) * grid.step_y)));
  };
  fill(relief, terrain.height, height);
  fill(mosaic, terrain.rgba, colour);
  return terrain;
}

inline uint32_t rgb(double r, double g, double b) {
  const auto byte = [](double x) { return static_cast<uint32_t>(std::lround(std::min(std::max(x, 0.0), 255.0))); };
  return byte(r) | byte(g) << 8 | byte(b) << 16 | 0xff000000u;
}

inline int red(uint32_t p) { return static_cast<int>(p & 255); }
inline int green(uint32_t p) { return static_cast<int>(p >> 8 & 255); }
inline int blue(uint32_t p) { return static_cast<int>(p >> 16 & 255); }
inline double grey(uint32_t p) { return 0.299 * red(p) + 0.587 * green(p) + 0.114 * blue(p); }

/// A camera at C whose image has north up when it looks straight down; turned by `heading` (clockwise seen from above), then
/// tilted by `tilt` so that the upper half of the image is farther away, then rolled.
inline SE3 looking_down(const Eigen::Vector3d& C, double heading = 0, double tilt = 0, double roll = 0) {
  using Eigen::AngleAxisd;
  using Eigen::Vector3d;
  Eigen::Matrix3d down;
  down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  return {AngleAxisd(-heading, Vector3d::UnitZ()).toRotationMatrix() * down *
              AngleAxisd(tilt, Vector3d::UnitX()).toRotationMatrix() * AngleAxisd(roll, Vector3d::UnitZ()).toRotationMatrix(),
          C};
}

}  // namespace iclk::test
