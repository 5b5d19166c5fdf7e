#include <iclk/render/terrain.h>

#include <algorithm>
#include <bit>
#include <cmath>

#include <iclk/engine/error.h>
#include <iclk/render/internal/text.h>

namespace iclk {

using internal::number;

namespace {

// Larger than all heights and depths of the Earth: such values are a forgotten nodata value, or feet.
constexpr double kHighest = 12000;

[[noreturn]] void fail(const std::string& why) { throw Error(ErrorCode::invalid_argument, "terrain: " + why); }

void check_grid(const Grid& grid, size_t values, const char* what) {
  if (grid.width < 2 || grid.height < 2)
    fail(std::string(what) + " of " + std::to_string(grid.width) + "x" + std::to_string(grid.height) +
         " is too small: at least 2x2");
  if (static_cast<size_t>(grid.width) * static_cast<size_t>(grid.height) != values)
    fail(std::string(what) + " of " + std::to_string(grid.width) + "x" + std::to_string(grid.height) + " has " +
         std::to_string(values) + " values");
  const bool finite =
      std::isfinite(grid.left) && std::isfinite(grid.top) && std::isfinite(grid.step_x) && std::isfinite(grid.step_y);
  if (!finite || !(grid.step_x > 0) || !(grid.step_y > 0))
    fail(std::string(what) + ": corner " + number(grid.left) + ", " + number(grid.top) + " and pixels of " +
         number(grid.step_x) + " x " + number(grid.step_y) + " m must be finite, the pixels positive");
}

}  // namespace

MapBox MapBox::intersection(const MapBox& other) const {
  return {std::max(left, other.left), std::max(bottom, other.bottom), std::min(right, other.right), std::min(top, other.top)};
}

std::string MapBox::text() const {
  return "x " + number(left) + " to " + number(right) + ", y " + number(bottom) + " to " + number(top);
}

MapBox Grid::centres() const {
  const MapBox outer = box();
  return {outer.left + 0.5 * step_x, outer.bottom + 0.5 * step_y, outer.right - 0.5 * step_x, outer.top - 0.5 * step_y};
}

std::optional<double> Terrain::height_at(double x, double y) const {
  const Eigen::Vector2d at = relief.pixel(x, y);
  if (!(at.x() >= 0 && at.y() >= 0 && at.x() <= relief.width - 1 && at.y() <= relief.height - 1)) return std::nullopt;
  const int u = std::min(static_cast<int>(at.x()), relief.width - 2), v = std::min(static_cast<int>(at.y()), relief.height - 2);
  const double a = at.x() - u, b = at.y() - v;
  const float* row = height.data() + static_cast<size_t>(v) * static_cast<size_t>(relief.width) + u;
  const float* next = row + relief.width;
  const double h = (1 - b) * ((1 - a) * row[0] + a * row[1]) + b * ((1 - a) * next[0] + a * next[1]);
  return std::isfinite(h) ? std::optional(h) : std::nullopt;
}

uint64_t Terrain::hash() const {
  uint64_t h = 0xcbf29ce484222325u;
  const auto mix = [&](uint64_t word) { h = (h ^ word) * 0x100000001b3u, h ^= h >> 29; };
  for (const Grid* grid : {&relief, &mosaic}) {
    mix(static_cast<uint64_t>(grid->width) << 32 | static_cast<uint32_t>(grid->height));
    for (const double value : {grid->left, grid->top, grid->step_x, grid->step_y}) mix(std::bit_cast<uint64_t>(value));
  }
  for (const float value : height) mix(std::isnan(value) ? 1 : std::bit_cast<uint32_t>(value));
  for (const uint32_t pixel : rgba) mix(pixel);
  return h;
}

void Terrain::check() const {
  check_grid(relief, height.size(), "elevation");
  check_grid(mosaic, rgba.size(), "mosaic");
  bool some = false;
  for (const float h : height) {
    if (std::isnan(h)) continue;
    some = true;
    if (!(std::abs(h) <= kHighest))
      fail("an elevation of " + number(h) +
           " m is impossible: declare the value that means no data (gdal_edit.py "
           "-a_nodata " +
           number(h) + "), or convert to metres");
  }
  if (!some) fail("the elevation has no data at any pixel");
  if (std::none_of(rgba.begin(), rgba.end(), [](uint32_t p) { return p >> 24 != 0; }))
    fail("the mosaic has no data at any pixel");
  if (extent().empty())
    fail("mosaic (" + mosaic.box().text() + ") and elevation (" + relief.box().text() +
         ") do not overlap: bring both into the same coordinate system, in metres (gdalwarp -t_srs)");
}

}  // namespace iclk
