#include <iclk/render/internal/landscape.h>

#include <algorithm>
#include <cmath>

#include <iclk/render/internal/noise.h>

namespace iclk::internal {

using Eigen::Vector3d;

Landscape::Landscape(uint64_t seed, double relief, const std::optional<Date>& date)
    : relief_(relief),
      salt_(static_cast<uint32_t>(seed * 0x9E3779B97F4A7C15u >> 32) | 1u),
      date_(date),
      sun_(date ? date->to_sun() : Vector3d(-0.5, 0.45, 0.74).normalized()),
      palette_(palette(date)) {
  if (!date) return;
  year_salt_ = hash(static_cast<int>(date->year), static_cast<int>(date->year >> 32), 1000);
  season_salt_ = hash(static_cast<int>(date->season), static_cast<int>(year_salt_), 1001);
}

double Landscape::ground(double x, double y) const {
  const double warp = 60 * noise(x / 230, y / 230, salt_ + 1);
  const double hills = turbulence(x + warp, y - warp, 420, 5, 0.45, salt_ + 10);
  const double ridge = 1 - std::abs(2 * turbulence(x, y, 300, 3, 0.5, salt_ + 20) - 1);
  return relief_ * (1.6 * (hills - 0.5) + 0.35 * ridge * ridge) + 1.2 * turbulence(x, y, 9, 2, 0.5, salt_ + 30);
}

double Landscape::surface(double x, double y) const {
  const double h = ground(x, y);
  const House house = house_at(x, y);
  if (house.inside) return h + house.wall + 0.7 * (house.half_width - std::abs(house.across));
  if (road(x, y).off < 4) return h;
  const double wood = wood_at(x, y);
  if (wood <= 0) return h;
  const Crown crown = crown_at(x, y);
  const double r = crown.distance / crown.radius;
  return r < 1 ? h + wood * (4 + 7 * unit(static_cast<int>(crown.kind), 1, salt_)) * std::sqrt(1 - r * r) : h + 0.5 * wood;
}

/// Sun and sky, so exposed that level ground in the sun is as bright as it is without a date.
Vector3d Landscape::light(const Vector3d& normal, double sunlit) const {
  const double direct = 0.85 * normal.dot(sun_);
  if (!date_) return Vector3d::Constant(std::clamp(0.35 + direct, 0.15, 1.3));
  const double level = 0.35 + 0.85 * sun_.z();
  return (0.98 / level) * (0.35 * Vector3d(0.92, 0.98, 1.12) + sunlit * std::max(direct, 0.0) * Vector3d(1.03, 1.0, 0.94));
}

Vector3d Landscape::colour(double x, double y, const Vector3d& normal, double sunlit) const {
  double fine = turbulence(x, y, 1.6, 3, 0.75, salt_ + 40), coarse = turbulence(x, y, 60, 5, 0.6, salt_ + 50);
  const Vector3d lit = light(normal, sunlit);
  const House house = house_at(x, y);
  if (house.inside) return snowed(x, y, roof(house, sunlit) * (0.75 + 0.35 * fine), 0.8);
  const Road way = road(x, y);
  if (way.off < 3.4) {
    const Vector3d c = road_colour(x, y, way.off) * (0.8 + 0.3 * fine);
    return date_ ? Vector3d(car(way).value_or(snowed(x, y, c, 0.25)).cwiseProduct(lit)) : c;
  }
  // Plants do not grow again as they were.
  if (date_) fine = 0.5 * (fine + turbulence(x, y, 1.6, 3, 0.75, salt_ + season_salt_ + 40));
  if (wood_at(x, y) > 0) return snowed(x, y, wood_colour(x, y) * (0.5 + 0.75 * fine), 0.35).cwiseProduct(lit);
  if (date_) coarse = 0.6 * coarse + 0.4 * turbulence(x, y, 60, 5, 0.6, salt_ + season_salt_ + 50);
  const double grain = 0.45 + 0.62 * fine + 0.5 * coarse;
  Vector3d c = mix(palette_.meadow[0], palette_.meadow[1], 2.2 * (coarse - 0.3));
  c = field(x, y, c);
  if (way.off < 4.6) c = mix({140, 128, 100}, c, 0.35);
  return snowed(x, y, c * grain, 0.95).cwiseProduct(lit);
}

/// Lines of a crooked grid.
Landscape::Road Landscape::road(double x, double y) const {
  const double a = x + 55 * noise(x / 140, y / 140, salt_ + 60), b = y + 55 * noise(x / 140, y / 140, salt_ + 61);
  const double cell = 190;
  const double da = std::abs(a / cell - std::round(a / cell)) * cell, db = std::abs(b / cell - std::round(b / cell)) * cell;
  const bool north = da < db;
  return {std::min(da, db), std::remainder(north ? a : b, cell), north ? b : a, north};
}

/// Cars in both lanes.
std::optional<Vector3d> Landscape::car(const Road& road) const {
  const double spacing = 16;
  const int lane = road.across > 0 ? 1 : 0, place = cell_of(road.along / spacing);
  const uint32_t salt = salt_ + season_salt_ + (road.north ? 130 : 131);
  if (unit(place, lane, salt) > 0.14) return std::nullopt;
  const double ahead = road.along - (place + 0.3 + 0.4 * unit(place, lane, salt + 2)) * spacing;
  const double aside = std::abs(road.across) - 1.6;
  if (std::abs(ahead) > 2.2 || std::abs(aside) > 0.9) return std::nullopt;
  static const Vector3d colours[] = {{210, 210, 212}, {30, 30, 34}, {120, 122, 128}, {150, 36, 34}, {44, 60, 112}};
  const bool glass = std::abs(ahead) > 0.9 && std::abs(ahead) < 1.4;
  return glass ? Vector3d(40, 46, 54) : colours[hash(place, lane, salt + 4) % 5];
}

Landscape::House Landscape::house_at(double x, double y) const {
  constexpr double lot = 26;
  const int ix = cell_of(x / lot), iy = cell_of(y / lot);
  House house;
  const double cx = (ix + 0.5) * lot, cy = (iy + 0.5) * lot;
  if (noise(cx / 170, cy / 170, salt_ + 70) < 0.62 || unit(ix, iy, salt_ + 71) < 0.3) return house;
  if (road(cx, cy).off < 14) return house;
  const double angle = M_PI * noise(cx / 300, cy / 300, salt_ + 72) + (unit(ix, iy, salt_ + 73) < 0.4 ? M_PI / 2 : 0);
  const double dx = x - cx - 2 * (unit(ix, iy, salt_ + 74) - 0.5), dy = y - cy - 2 * (unit(ix, iy, salt_ + 75) - 0.5);
  house.half_width = 3.2 + 2.2 * unit(ix, iy, salt_ + 76);
  house.half_length = 5 + 4 * unit(ix, iy, salt_ + 77);
  house.wall = 3 + 4 * unit(ix, iy, salt_ + 78);
  house.angle = angle;
  house.across = -std::sin(angle) * dx + std::cos(angle) * dy;
  house.along = std::cos(angle) * dx + std::sin(angle) * dy;
  house.inside = std::abs(house.across) < house.half_width && std::abs(house.along) < house.half_length;
  house.kind = hash(ix, iy, salt_ + 79);
  return house;
}

Vector3d Landscape::roof(const House& house, double sunlit) const {
  static const Vector3d colours[] = {{168, 92, 70}, {142, 70, 58}, {120, 112, 108}, {186, 130, 96}, {92, 88, 96}};
  Vector3d c = colours[house.kind % 5];
  if (date_) {
    const double down = 0.7 * (house.across > 0 ? 1 : -1);  // the roof falls to both sides of its ridge
    c = c.cwiseProduct(light(Vector3d(-down * std::sin(house.angle), down * std::cos(house.angle), 1).normalized(), sunlit));
  } else {
    c *= house.across > 0 ? 1.12 : 0.72;
  }
  const double tiles = std::sin(2 * M_PI * std::abs(house.across) / 1.1), edge = house.half_width - std::abs(house.across);
  c *= 1 + 0.1 * tiles;
  if (edge < 0.35 || house.half_length - std::abs(house.along) < 0.3) c *= 0.6;
  if (std::abs(house.across) < 0.3) c *= 1.25;
  const double chimney_u = house.along - 0.5 * house.half_length, chimney_v = house.across - 1.5;
  if (std::abs(chimney_u) < 0.6 && std::abs(chimney_v) < 0.5) c = {70, 55, 50};
  return c;
}

Vector3d Landscape::road_colour(double x, double y, double off) const {
  if (off < 0.16 && std::fmod(std::abs(x) + std::abs(y), 9) < 4.5) return {225, 222, 210};
  if (off > 2.7 && off < 2.95) return {200, 198, 190};
  return mix(palette_.road[0], palette_.road[1], turbulence(x, y, 14, 3, 0.6, salt_ + 80));
}

double Landscape::wood_at(double x, double y) const { return ramp(turbulence(x, y, 150, 3, 0.5, salt_ + 90), 0.54, 0.56); }

Landscape::Crown Landscape::crown_at(double x, double y) const {
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

Vector3d Landscape::wood_colour(double x, double y) const {
  const Crown crown = crown_at(x, y);
  const double r = crown.distance / crown.radius;
  const double kind = unit(static_cast<int>(crown.kind), 2, salt_);
  if (r > 1) return palette_.floor;
  if (!date_) return mix(palette_.crown[0], kind < 0.15 ? palette_.leaves[1] : palette_.crown[1], kind) * (1.25 - 0.55 * r);
  if (unit(static_cast<int>(crown.kind), 3, salt_) < 0.4)
    return mix(palette_.crown[0], palette_.crown[1], kind) * (1.25 - 0.55 * r);
  // Branches are as thin as a texel.
  const double branches = noise(3 * x, 3 * y, salt_ + season_salt_ + 104);
  return mix(mix(palette_.leaves[0], palette_.leaves[1], kind), palette_.floor, palette_.bare * branches) * (1.2 - 0.45 * r);
}

/// Parcels of a crooked grid, many ploughed; hedges between some.
Vector3d Landscape::field(double x, double y, const Vector3d& meadow) const {
  const double a = (x + 38 * noise(x / 90, y / 90, salt_ + 110)) / 74, b = (y + 38 * noise(x / 90, y / 90, salt_ + 111)) / 52;
  const int i = cell_of(a), j = cell_of(b);
  const double edge = std::min({74 * (a - i), 74 * (i + 1 - a), 52 * (b - j), 52 * (j + 1 - b)});
  const double kind = unit(i, j, salt_ + 112);
  if (edge < 1.3 && unit(i, j, salt_ + 113) < 0.5) return palette_.hedge * (0.6 + 0.8 * noise(x, y, salt_ + 114));
  if (kind < 0.35) return meadow;
  const Vector3d& crop = palette_.crops[hash(i, j, salt_ + year_salt_ + 115) % 6];
  const double angle = M_PI * unit(i, j, salt_ + 116), spacing = 1.2 + 2.6 * unit(i, j, salt_ + year_salt_ + 117);
  const double furrow = std::sin(2 * M_PI * (std::cos(angle) * x + std::sin(angle) * y) / spacing);
  const double tracks = std::abs(std::remainder(std::cos(angle) * x + std::sin(angle) * y, 18)) < 0.5 ? 0.75 : 1;
  return mix(crop, meadow, 0.25) * (1 + 0.13 * furrow) * tracks * (0.8 + 0.35 * unit(i, j, salt_ + season_salt_ + 118));
}

/// `share` of what is there lies under snow, where there is snow.
Vector3d Landscape::snowed(double x, double y, const Vector3d& c, double share) const {
  if (palette_.snow == 0) return c;
  const double cover =
      palette_.snow * share * (0.75 + 0.25 * ramp(turbulence(x, y, 25, 4, 0.6, salt_ + season_salt_ + 120), 0.3, 0.5));
  return mix(c, Vector3d(206, 210, 218) * (0.96 + 0.08 * noise(2 * x, 2 * y, salt_ + season_salt_ + 121)), cover);
}

}  // namespace iclk::internal
