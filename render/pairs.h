#pragma once
#include <cmath>
#include <cstdint>
#include <optional>
#include <string>

#include <iclk/render/renderer.h>

namespace iclk {

/// Which cameras are drawn. The defaults start as far from the truth as the paper's pairs: 34 px, 4.9 m and 0.075 rad in the
/// mean.
struct PairOptions {
  Camera camera{455, 455, 375.5, 239.5, 752, 480};
  double altitude_min = 100, altitude_max = 180;  ///< m above the ground below the first camera
  double tilt = 15 * 0.017453292519943295;        ///< rad from straight down, at most
  double translation = 5.1;                       ///< m; each component of the perturbation lies in -this .. this
  double rotation = 0.078;                        ///< rad; the same of the rotation vector
  /// rad. Where the maximum is not 0, pairs lie on an orbit: both cameras stand level, equally far from a point on the ground
  /// and up to `tilt` from straight above it, and look at it from azimuths that differ by so much, to either side. The second
  /// one's height differs by up to a quarter and it is turned by the perturbation's rotation; `translation` is not used.
  double orbit_min = 0, orbit_max = 0;
  double start_min = 0, start_max = INFINITY;  ///< px between where the views show the same ground, in the mean over camera 0
  double nearest = 0.3;                        ///< no ground nearer than this share of the altitude
  MapBox region{0, 0, 1, 1};                   ///< of the terrain's extent, in fractions from its south-west corner
  uint64_t seed = 0;
  Lens lens;  ///< of `camera`, through which both views are taken
  /// Where it is set, camera 1 is the second one of a rig: T_10 is the rig's, no perturbation and no orbit is drawn.
  struct Second {
    Camera camera;
    Lens lens;
    SE3 T_10;
  };
  std::optional<Second> second;

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// Two views whose fields of view lie in the region and see ground with a picture in every pixel to which the lens shows
/// anything.
struct RenderedPair {
  SE3 T_W0, T_W1;  ///< camera to map
  SE3 T_10;        ///< camera 0 to camera 1, the truth
  View view0, view1;
  double altitude = 0;  ///< m above ground, of camera 0; on an orbit above the point that it looks at
};

/// Draws pairs: position, altitude, heading, tilt and roll of the first camera are uniform, the second camera is the first one
/// perturbed in its own frame by a translation and a rotation vector of uniform components, or both lie on an orbit
/// (PairOptions::orbit_max). Pairs of which a view leaves the region, meets missing data or comes too near to the ground, and
/// those that start elsewhere than PairOptions wants, are drawn again.
class PairSource {
 public:
  /// Why poses were drawn again.
  struct Rejected {
    int64_t draws = 0;
    int64_t outside = 0;   ///< a view left the region or met missing data
    int64_t too_near = 0;  ///< ground nearer than PairOptions::nearest
    int64_t start = 0;     ///< a start outside PairOptions::start_min .. start_max
    std::string text() const;
  };

  /// `renderer` must outlive it. Throws as PairOptions::check, and Error(invalid_argument) for a region in which nothing lies.
  PairSource(TerrainRenderer& renderer, const PairOptions& options);

  /// Pair `index` of the set that the seed stands for, whatever was drawn before. Throws Error(invalid_argument) with what the
  /// field of view needs and what the region has if no pair is found.
  RenderedPair draw(uint64_t index);

  const Rejected& rejected() const { return rejected_; }
  const MapBox& region() const { return region_; }

 private:
  class Random;
  /// A camera, and one that has few pixels of its whole view.
  struct Eye {
    Camera camera, quick;
    Lens lens;
    std::vector<Eigen::Vector2d> rays, quick_rays;  ///< (x, y) of every pixel, NaN where the lens shows nothing
    Eye(const Camera& camera, const Lens& lens);
  };
  bool acceptable(const View& view, const std::vector<Eigen::Vector2d>& rays, const SE3& T_WC, double nearest);
  /// Poses and altitude, without views; false where the map has no ground.
  bool draw_perturbed(Random& random, RenderedPair& pair) const;
  bool draw_orbit(Random& random, RenderedPair& pair) const;

  TerrainRenderer& renderer_;
  PairOptions options_;
  MapBox region_;
  std::vector<Eye> eyes_;  ///< camera 0, and camera 1 where it is another
  Rejected rejected_;
};

}  // namespace iclk
