#pragma once
#include <cmath>
#include <cstdint>
#include <optional>
#include <string>

#include <iclk/render/renderer.h>

namespace iclk {

/// Which camera poses are drawn. With the defaults, pairs start as far from the truth as the paper's pairs: 34 px, 4.9 m and
/// 0.075 rad on average.
struct PairOptions {
  Camera camera{455, 455, 375.5, 239.5, 752, 480};
  double altitude_min = 100, altitude_max = 180;  ///< m above the ground below the first camera
  double tilt = 15 * 0.017453292519943295;        ///< rad from straight down, at most
  double translation = 5.1;                       ///< m; each component of the perturbation is in [-translation, translation]
  double rotation = 0.078;                        ///< rad; the same for the rotation vector
  /// Orbits, if orbit_max is not 0. Both cameras are level and look at a point on the ground, equally far from it and up to
  /// `tilt` from straight above it. Their azimuths differ by orbit_min to orbit_max (rad), to either side. The height of the
  /// second camera differs by up to a quarter, and `rotation` perturbs it; `translation` is not used.
  double orbit_min = 0, orbit_max = 0;
  double start_min = 0, start_max = INFINITY;  ///< px between the same ground in both views, mean over camera 0
  double nearest = 0.3;                        ///< no ground is nearer than this share of the altitude
  MapBox region{0, 0, 1, 1};                   ///< of the terrain's extent, as fractions from its south-west corner
  uint64_t seed = 0;
  Lens lens;  ///< of `camera`, for both views
  /// If set, camera 1 is the second camera of a rig with a given T_10; no perturbation and no orbit is drawn.
  struct Second {
    Camera camera;
    Lens lens;
    SE3 T_10;
  };
  std::optional<Second> second;

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// Two views inside the region. Every pixel in the domain of the lens sees ground with a picture.
struct RenderedPair {
  SE3 T_W0, T_W1;  ///< camera to map
  SE3 T_10;        ///< camera 0 to camera 1, the truth
  View view0, view1;
  double altitude = 0;  ///< m of camera 0 above the ground below it, or on an orbit above the point that it looks at
};

/// Draws random pairs. Position, altitude, heading, tilt and roll of the first camera are uniform. The second camera is the
/// first one, perturbed in its own frame by a translation and a rotation vector of uniform components. Or both lie on an orbit
/// (PairOptions::orbit_max). A pair is drawn again if a view leaves the region, sees missing data or is too near to the ground.
/// It is also drawn again if its start is outside the limits of PairOptions.
class PairSource {
 public:
  /// Why poses were drawn again.
  struct Rejected {
    int64_t draws = 0;
    int64_t outside = 0;   ///< a view left the region or saw missing data
    int64_t too_near = 0;  ///< ground nearer than PairOptions::nearest
    int64_t start = 0;     ///< a start outside PairOptions::start_min .. start_max
    std::string text() const;
  };

  /// The renderers must outlive it. `target` renders view 1, of the same ground at another date; without it, `renderer` does.
  /// Throws the errors of PairOptions::check(), and Error(invalid_argument) for an empty region.
  PairSource(TerrainRenderer& renderer, const PairOptions& options, TerrainRenderer* target = nullptr);

  /// Draws pair `index` of the set of this seed; it does not depend on earlier draws. If no pair is found, throws
  /// Error(invalid_argument) with the sizes of the field of view and of the region.
  RenderedPair draw(uint64_t index);

  const Rejected& rejected() const { return rejected_; }
  const MapBox& region() const { return region_; }

 private:
  class Random;
  /// A camera, and a copy of it with few pixels for quick tests.
  struct Eye {
    Camera camera, quick;
    Lens lens;
    std::vector<Eigen::Vector2d> rays, quick_rays;  ///< (x, y) of every pixel, NaN outside the domain of the lens
    Eye(const Camera& camera, const Lens& lens);
  };
  bool acceptable(const View& view, const std::vector<Eigen::Vector2d>& rays, const SE3& T_WC, double nearest);
  /// Draw poses and altitude, without views. They return false if the map has no ground there.
  bool draw_perturbed(Random& random, RenderedPair& pair) const;
  bool draw_orbit(Random& random, RenderedPair& pair) const;

  TerrainRenderer& renderer_;
  TerrainRenderer& target_;
  PairOptions options_;
  MapBox region_;
  std::vector<Eye> eyes_;  ///< camera 0, and camera 1 if it differs
  Rejected rejected_;
};

}  // namespace iclk
