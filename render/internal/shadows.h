#pragma once
#include <vector>

#include <Eigen/Core>

#include <iclk/render/terrain.h>

namespace iclk::internal {

/// The shadows that a terrain casts on itself.
class Shadows {
 public:
  /// `to_sun`: from the ground to the sun, above the horizon. Keeps a reference to the terrain, whose heights must be complete.
  Shadows(const Terrain& terrain, const Eigen::Vector3d& to_sun, int threads);
  /// The share of the sun that is seen from the ground at a point of the map.
  double sunlit(double x, double y) const;

 private:
  const Terrain& terrain_;
  Terrain edge_;  ///< below these heights lies shadow
};

}  // namespace iclk::internal
