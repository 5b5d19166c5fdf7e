#pragma once
#include <cstdint>

#include <iclk/render/terrain.h>

namespace iclk {

struct ProceduralOptions {
  uint64_t seed = 0;
  double size = 1024;         ///< m of a side; the map begins at (0, 0)
  double mosaic_step = 0.25;  ///< m a texel
  double relief_step = 1;     ///< m between heights
  double relief = 120;        ///< m between valleys and tops, about
  int threads = 0;            ///< 0: one a core

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// A landscape made in code: hills with meadows, ploughed fields with hedges, roads, villages with gabled roofs, woods of
/// single crowns; texture at every scale from the map's down to a texel's. Roofs and crowns stand above the ground. The same
/// options give the same terrain, on any number of threads. Throws as ProceduralOptions::check.
Terrain procedural_terrain(const ProceduralOptions& options);

}  // namespace iclk
