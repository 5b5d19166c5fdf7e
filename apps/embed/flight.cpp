#include "apps/embed/flight.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

namespace embed {
namespace {

using Eigen::AngleAxisd;
using Eigen::Vector3d;

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

}  // namespace embed
