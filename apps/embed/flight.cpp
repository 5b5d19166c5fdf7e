#include "apps/embed/flight.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <Eigen/Geometry>

namespace embed {
namespace {

using Eigen::AngleAxisd;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kHollow = 0.4;  // m
constexpr double kBorder = 17;   // px

}  // namespace

iclk::SE3 camera_pose(const iclk::Terrain& terrain, int frame) {
  const iclk::MapBox map = terrain.extent();
  const double radius = 0.17 * std::min(map.width(), map.height()), a = 4.0 * frame / radius;
  const double highest = *std::max_element(terrain.height.begin(), terrain.height.end());
  Eigen::Matrix3d down;
  down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  const Vector3d middle((map.left + map.right) / 2, (map.bottom + map.top) / 2, highest + 90);
  return {AngleAxisd(a + 0.05 * std::sin(5 * a), Vector3d::UnitZ()).toRotationMatrix() * down *
              AngleAxisd(0.1 + 0.05 * std::sin(7 * a), Vector3d::UnitX()).toRotationMatrix() *
              AngleAxisd(0.04 * std::sin(6 * a + 1), Vector3d::UnitY()).toRotationMatrix(),
          middle + Vector3d(radius * std::cos(a), radius * std::sin(a), 8 * std::sin(3 * a))};
}

std::vector<Landmark> landmarks(const iclk::Terrain& terrain, double spacing) {
  const iclk::MapBox map = terrain.extent();
  std::vector<Landmark> points;
  for (double y = map.bottom + spacing; y < map.top - spacing; y += spacing)
    for (double x = map.left + spacing; x < map.right - spacing; x += spacing) {
      const auto h = terrain.height_at(x, y);
      double hollow = 0, roughness = 0;
      bool known = h.has_value();
      for (const double r : {1.5, 3.0})
        for (const Vector2d& d : {Vector2d(r, 0), Vector2d(0, r), Vector2d(r, r), Vector2d(r, -r)}) {
          const auto a = terrain.height_at(x + d.x(), y + d.y()), b = terrain.height_at(x - d.x(), y - d.y());
          known = known && a && b;
          if (!known) break;
          hollow = std::max(hollow, (*a + *b) / 2 - *h);
          roughness = std::max(roughness, std::abs((*a + *b) / 2 - *h));
        }
      if (known && hollow < kHollow) points.push_back({{x, y, *h}, roughness});
    }
  return points;
}

iclk::Features visible_features(const std::vector<Landmark>& landmarks, const iclk::Camera& camera, const iclk::SE3& T_WC,
                                int count) {
  // About as many cells as features; a cell takes its least rough landmark.
  const double side = std::sqrt((camera.width - 2 * kBorder) * (camera.height - 2 * kBorder) / std::max(count, 1));
  const int columns = std::max(1, static_cast<int>((camera.width - 2 * kBorder) / side)), rows = std::max(1, count / columns);
  const Vector2d cell((camera.width - 2 * kBorder) / columns, (camera.height - 2 * kBorder) / rows);
  struct Best {
    double roughness = INFINITY, inverse_depth = 0;
    Vector2d uv;
  };
  std::vector<Best> best(static_cast<size_t>(columns) * static_cast<size_t>(rows));
  const iclk::SE3 T_CW = T_WC.inverse();
  for (const Landmark& landmark : landmarks) {
    const Vector3d X = T_CW * landmark.X;
    if (X.z() < 1) continue;
    const Vector2d uv = camera.project(X), at = (uv - Vector2d(kBorder, kBorder)).cwiseQuotient(cell);
    if (!(at.x() >= 0 && at.y() >= 0 && at.x() < columns && at.y() < rows)) continue;
    const Vector2d whole = at.array().floor();
    Best& b = best[static_cast<size_t>(whole.y()) * static_cast<size_t>(columns) + static_cast<size_t>(whole.x())];
    if (landmark.roughness < b.roughness) b = {landmark.roughness, 1 / X.z(), uv};
  }
  iclk::Features features;
  for (const Best& b : best)
    if (b.inverse_depth > 0) {
      features.uv.push_back(b.uv);
      features.inverse_depth.push_back(b.inverse_depth);
    }
  return features;
}

}  // namespace embed
