#pragma once
#include <cstdint>
#include <optional>

#include <iclk/render/date.h>
#include <iclk/render/terrain.h>

namespace iclk {

struct ProceduralOptions {
  uint64_t seed = 0;
  double size = 1024;          ///< m per side; the map begins at (0, 0)
  double mosaic_step = 0.25;   ///< m per texel
  double relief_step = 1;      ///< m between heights
  double relief = 120;         ///< m between valleys and hilltops, about
  std::optional<Date> date{};  ///< none: early summer, with light but without cast shadows
  int threads = 0;             ///< 0: one per core

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// Generates a landscape: hills with meadows, ploughed fields with hedges, roads, villages with gabled roofs, woods of separate
/// crowns. It has texture at every scale from the map to a texel. Roofs and crowns rise above the ground. Equal options give
/// equal terrain, with any number of threads. Throws the errors of ProceduralOptions::check().
Terrain procedural_terrain(const ProceduralOptions& options);

}  // namespace iclk
