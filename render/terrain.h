#pragma once
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace iclk {

/// A rectangle of the map, metres.
struct MapBox {
  double left = 0, bottom = 0, right = 0, top = 0;

  bool empty() const { return !(left < right && bottom < top); }
  double width() const { return right - left; }
  double height() const { return top - bottom; }
  bool contains(double x, double y) const { return x >= left && x <= right && y >= bottom && y <= top; }
  MapBox intersection(const MapBox& other) const;
  /// For example "x 500 to 1500, y 0 to 1000".
  std::string text() const;
};

/// The position of a north-up raster on the map: x east, y north, metres. Pixels are areas; a value belongs to the centre of
/// its pixel.
struct Grid {
  int width = 0, height = 0;      ///< pixels
  double left = 0, top = 0;       ///< m, outer corner of the first pixel
  double step_x = 1, step_y = 1;  ///< m per pixel, positive; the next row lies further south

  /// The box of the outer edges.
  MapBox box() const { return {left, top - height * step_y, left + width * step_x, top}; }
  /// The box of the centres of the outermost pixels: interpolation inside it has four neighbours.
  MapBox centres() const;
  /// Column and row of a point of the map; pixel centres are whole numbers.
  Eigen::Vector2d pixel(double x, double y) const { return {(x - left) / step_x - 0.5, (top - y) / step_y - 0.5}; }
};

/// Ground and its appearance: heights and a mosaic of photographs, each on its own grid, in one map frame in metres (x east,
/// y north, z up). The ground consists of bilinear patches between the centres of the heights.
struct Terrain {
  Grid relief;
  std::vector<float> height;  ///< m, row-major; NaN: no data
  Grid mosaic;
  std::vector<uint32_t> rgba;  ///< row-major, R in the lowest byte; alpha 0: no data, 255: data

  /// The part of the map that both grids cover.
  MapBox extent() const { return relief.centres().intersection(mosaic.box()); }
  /// The height of the ground; nothing outside the relief and where one of the four surrounding heights is missing.
  std::optional<double> height_at(double x, double y) const;

  /// A hash of grids, heights and pixels, to compare terrains. It is not secure against deliberate collisions.
  uint64_t hash() const;

  /// Throws Error(invalid_argument) that names the value and the remedy. Sizes must fit, steps must be positive, and heights
  /// must be finite or NaN and within 12 km. There must be heights and pixels with data, and the extents must overlap.
  void check() const;
};

}  // namespace iclk
