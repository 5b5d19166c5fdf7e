#include <iclk/render/procedural.h>

#include <algorithm>
#include <cmath>
#include <string>

#include <iclk/align/common/each.h>
#include <iclk/engine/error.h>

namespace iclk {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

uint32_t hash(int x, int y, uint32_t salt) {
  uint32_t h = static_cast<uint32_t>(x) * 0x9E3779B1u ^ static_cast<uint32_t>(y) * 0x85EBCA77u ^ salt * 0xC2B2AE3Du;
  h = (h ^ (h >> 15)) * 0x2C1B3C6Du;
  h = (h ^ (h >> 12)) * 0x297A2D39u;
  return h ^ (h >> 15);
}

double unit(int x, int y, uint32_t salt) { return hash(x, y, salt) * (1.0 / 4294967296.0); }

int cell_of(double x) { return static_cast<int>(std::floor(x)); }

/// Value noise in [0, 1] with cells of side 1.
double noise(double x, double y, uint32_t salt) {
  const int ix = cell_of(x), iy = cell_of(y);
  const auto smooth = [](double t) { return t * t * t * (t * (6 * t - 15) + 10); };
  const double a = smooth(x - ix), b = smooth(y - iy);
  const double low = unit(ix, iy, salt) * (1 - a) + unit(ix + 1, iy, salt) * a;
  const double high = unit(ix, iy + 1, salt) * (1 - a) + unit(ix + 1, iy + 1, salt) * a;
  return low * (1 - b) + high * b;
}

/// Noise of several scales, about in [0, 1]. Each scale is rotated, to hide the directions of the grid.
double turbulence(double x, double y, double cell, int octaves, double gain, uint32_t salt) {
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

double ramp(double x, double from, double to) { return std::clamp((x - from) / (to - from), 0.0, 1.0); }
Vector3d mix(const Vector3d& a, const Vector3d& b, double t) { return a + std::clamp(t, 0.0, 1.0) * (b - a); }

/// A house on its lot.
struct House {
  bool inside = false;
  double across = 0, along = 0;  // m, across and along the ridge
  double half_width = 0, half_length = 0, wall = 0;
  uint32_t kind = 0;
};

/// The crown of the nearest tree.
struct Crown {
  double radius = 0, distance = 0;  // m
  uint32_t kind = 0;
};

class Landscape {
 public:
  explicit Landscape(const ProceduralOptions& options)
      : options_(options), salt_(static_cast<uint32_t>(options.seed * 0x9E3779B97F4A7C15u >> 32) | 1u) {}

  double ground(double x, double y) const {
    const double warp = 60 * noise(x / 230, y / 230, salt_ + 1);
    const double hills = turbulence(x + warp, y - warp, 420, 5, 0.45, salt_ + 10);
    const double ridge = 1 - std::abs(2 * turbulence(x, y, 300, 3, 0.5, salt_ + 20) - 1);
    return options_.relief * (1.6 * (hills - 0.5) + 0.35 * ridge * ridge) + 1.2 * turbulence(x, y, 9, 2, 0.5, salt_ + 30);
  }

  /// The height, including roofs and crowns.
  double surface(double x, double y) const {
    const double h = ground(x, y);
    const House house = house_at(x, y);
    if (house.inside) return h + house.wall + 0.7 * (house.half_width - std::abs(house.across));
    if (road(x, y) < 4) return h;
    const double wood = wood_at(x, y);
    if (wood <= 0) return h;
    const Crown crown = crown_at(x, y);
    const double r = crown.distance / crown.radius;
    return r < 1 ? h + wood * (4 + 7 * unit(static_cast<int>(crown.kind), 1, salt_)) * std::sqrt(1 - r * r) : h + 0.5 * wood;
  }

  /// RGB in [0, 255]; `light` from the slope of the surface.
  Vector3d colour(double x, double y, double light) const {
    const double fine = turbulence(x, y, 1.6, 3, 0.75, salt_ + 40), coarse = turbulence(x, y, 60, 5, 0.6, salt_ + 50);
    const double grain = 0.45 + 0.62 * fine + 0.5 * coarse;
    const House house = house_at(x, y);
    if (house.inside) return roof(house) * (0.75 + 0.35 * fine);
    const double off = road(x, y);
    if (off < 3.4) return road_colour(x, y, off) * (0.8 + 0.3 * fine);
    if (wood_at(x, y) > 0) return wood_colour(x, y) * (0.5 + 0.75 * fine) * light;
    Vector3d c = mix({104, 128, 62}, {150, 140, 84}, 2.2 * (coarse - 0.3));
    c = field(x, y, c);
    if (off < 4.6) c = mix({140, 128, 100}, c, 0.35);
    return c * grain * light;
  }

 private:
  /// Distance to the middle of the nearest road, m: lines of a crooked grid.
  double road(double x, double y) const {
    const double a = x + 55 * noise(x / 140, y / 140, salt_ + 60), b = y + 55 * noise(x / 140, y / 140, salt_ + 61);
    const double cell = 190;
    const double da = std::abs(a / cell - std::round(a / cell)) * cell, db = std::abs(b / cell - std::round(b / cell)) * cell;
    return std::min(da, db);
  }

  House house_at(double x, double y) const {
    constexpr double lot = 26;
    const int ix = cell_of(x / lot), iy = cell_of(y / lot);
    House house;
    const double cx = (ix + 0.5) * lot, cy = (iy + 0.5) * lot;
    if (noise(cx / 170, cy / 170, salt_ + 70) < 0.62 || unit(ix, iy, salt_ + 71) < 0.3) return house;
    if (road(cx, cy) < 14) return house;
    const double angle = M_PI * noise(cx / 300, cy / 300, salt_ + 72) + (unit(ix, iy, salt_ + 73) < 0.4 ? M_PI / 2 : 0);
    const double dx = x - cx - 2 * (unit(ix, iy, salt_ + 74) - 0.5), dy = y - cy - 2 * (unit(ix, iy, salt_ + 75) - 0.5);
    house.half_width = 3.2 + 2.2 * unit(ix, iy, salt_ + 76);
    house.half_length = 5 + 4 * unit(ix, iy, salt_ + 77);
    house.wall = 3 + 4 * unit(ix, iy, salt_ + 78);
    house.across = -std::sin(angle) * dx + std::cos(angle) * dy;
    house.along = std::cos(angle) * dx + std::sin(angle) * dy;
    house.inside = std::abs(house.across) < house.half_width && std::abs(house.along) < house.half_length;
    house.kind = hash(ix, iy, salt_ + 79);
    return house;
  }

  Vector3d roof(const House& house) const {
    static const Vector3d colours[] = {{168, 92, 70}, {142, 70, 58}, {120, 112, 108}, {186, 130, 96}, {92, 88, 96}};
    Vector3d c = colours[house.kind % 5] * (house.across > 0 ? 1.12 : 0.72);
    const double tiles = std::sin(2 * M_PI * std::abs(house.across) / 1.1), edge = house.half_width - std::abs(house.across);
    c *= 1 + 0.1 * tiles;
    if (edge < 0.35 || house.half_length - std::abs(house.along) < 0.3) c *= 0.6;
    if (std::abs(house.across) < 0.3) c *= 1.25;
    const double chimney_u = house.along - 0.5 * house.half_length, chimney_v = house.across - 1.5;
    if (std::abs(chimney_u) < 0.6 && std::abs(chimney_v) < 0.5) c = {70, 55, 50};
    return c;
  }

  Vector3d road_colour(double x, double y, double off) const {
    if (off < 0.16 && std::fmod(std::abs(x) + std::abs(y), 9) < 4.5) return {225, 222, 210};
    if (off > 2.7 && off < 2.95) return {200, 198, 190};
    return mix({112, 112, 116}, {140, 134, 126}, turbulence(x, y, 14, 3, 0.6, salt_ + 80));
  }

  double wood_at(double x, double y) const { return ramp(turbulence(x, y, 150, 3, 0.5, salt_ + 90), 0.54, 0.56); }

  Crown crown_at(double x, double y) const {
    constexpr double cell = 6;
    const int ix = cell_of(x / cell), iy = cell_of(y / cell);
    Crown best;
    double least = 1e9;
    for (int v = iy - 1; v <= iy + 1; ++v)
      for (int u = ix - 1; u <= ix + 1; ++u) {
        const double dx = x - (u + unit(u, v, salt_ + 100)) * cell, dy = y - (v + unit(u, v, salt_ + 101)) * cell;
        const double radius = 2.2 + 2.2 * unit(u, v, salt_ + 102), distance = std::sqrt(dx * dx + dy * dy);
        if (distance / radius < least) least = distance / radius, best = {radius, distance, hash(u, v, salt_ + 103) >> 8};
      }
    return best;
  }

  Vector3d wood_colour(double x, double y) const {
    const Crown crown = crown_at(x, y);
    const double r = crown.distance / crown.radius;
    const double kind = unit(static_cast<int>(crown.kind), 2, salt_);
    if (r > 1) return {36, 42, 28};
    return mix({52, 84, 44}, kind < 0.15 ? Vector3d(150, 120, 50) : Vector3d(104, 124, 58), kind) * (1.25 - 0.55 * r);
  }

  /// Parcels of a crooked grid, many ploughed; hedges between some.
  Vector3d field(double x, double y, const Vector3d& meadow) const {
    const double a = (x + 38 * noise(x / 90, y / 90, salt_ + 110)) / 74, b = (y + 38 * noise(x / 90, y / 90, salt_ + 111)) / 52;
    const int i = cell_of(a), j = cell_of(b);
    const double edge = std::min({74 * (a - i), 74 * (i + 1 - a), 52 * (b - j), 52 * (j + 1 - b)});
    const double kind = unit(i, j, salt_ + 112);
    if (edge < 1.3 && unit(i, j, salt_ + 113) < 0.5) return Vector3d(50, 68, 38) * (0.6 + 0.8 * noise(x, y, salt_ + 114));
    if (kind < 0.35) return meadow;
    static const Vector3d crops[] = {{186, 164, 98},  {138, 104, 74}, {116, 142, 62},
                                     {204, 186, 124}, {98, 78, 60},   {150, 160, 84}};
    const Vector3d& crop = crops[hash(i, j, salt_ + 115) % 6];
    const double angle = M_PI * unit(i, j, salt_ + 116), spacing = 1.2 + 2.6 * unit(i, j, salt_ + 117);
    const double furrow = std::sin(2 * M_PI * (std::cos(angle) * x + std::sin(angle) * y) / spacing);
    const double tracks = std::abs(std::remainder(std::cos(angle) * x + std::sin(angle) * y, 18)) < 0.5 ? 0.75 : 1;
    return mix(crop, meadow, 0.25) * (1 + 0.13 * furrow) * tracks * (0.8 + 0.35 * unit(i, j, salt_ + 118));
  }

  ProceduralOptions options_;
  uint32_t salt_;
};

}  // namespace

void ProceduralOptions::check() const {
  const auto fail = [](const std::string& why) { throw Error(ErrorCode::invalid_argument, "procedural terrain: " + why); };
  if (!(relief_step > 0) || !(mosaic_step > 0) || !(size >= 4 * std::max(relief_step, mosaic_step)))
    fail("a size of " + std::to_string(size) + " m, heights " + std::to_string(relief_step) + " m and texels " +
         std::to_string(mosaic_step) + " m apart: steps must be positive and the size at least four of them");
  if (!(size / mosaic_step <= 65536) || !(size / relief_step <= 65536))
    fail("a size of " + std::to_string(size) + " m has more than 65536 steps; use longer steps");
  if (!(relief >= 0 && relief <= 5000)) fail("a relief of " + std::to_string(relief) + " m must be 0 to 5000");
}

Terrain procedural_terrain(const ProceduralOptions& options) {
  options.check();
  const Landscape landscape(options);
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
  const Vector3d sun = Vector3d(-0.5, 0.45, 0.74).normalized();
  internal::for_each_of(static_cast<size_t>(m.height), options.threads, [&](size_t row) {
    const int v = static_cast<int>(row);
    for (int u = 0; u < m.width; ++u) {
      const double x = m.left + (u + 0.5) * m.step_x, y = m.top - (v + 0.5) * m.step_y, d = r.step_x;
      const auto h = [&](double dx, double dy) { return terrain.height_at(x + dx, y + dy).value_or(0); };
      const Vector3d normal = Vector3d((h(-d, 0) - h(d, 0)) / (2 * d), (h(0, -d) - h(0, d)) / (2 * d), 1).normalized();
      const Vector3d c = landscape.colour(x, y, std::clamp(0.35 + 0.85 * normal.dot(sun), 0.15, 1.3));
      uint32_t p = 0xff000000u;
      for (int i = 0; i < 3; ++i) p |= static_cast<uint32_t>(std::clamp(c[i] + 0.5, 0.0, 255.0)) << (8 * i);
      terrain.rgba[static_cast<size_t>(v) * static_cast<size_t>(m.width) + static_cast<size_t>(u)] = p;
    }
  });
  return terrain;
}

}  // namespace iclk
