#pragma once
#include <cstdint>
#include <optional>

#include <nlohmann/json.hpp>

#include <iclk/render/date.h>
#include <iclk/render/terrain.h>

namespace iclk {

/// When frames and their map show procedural ground.
struct Dates {
  Date frames, map;
};

/// What a map has wrong, compared with the ground that pictures see. The defaults are a perfect map.
struct MapDefects {
  uint64_t seed = 0;             ///< of all that is random in the map
  double texel = 0;              ///< m per pixel of the mosaic; 0: as it is
  double spacing = 0;            ///< m between heights, which are smoothed with half of it; 0: as they are
  double height_noise = 0;       ///< m, standard deviation; correlated over three heights
  double missing = 0;            ///< share of the houses and small groups of trees that the heights lack
  double block = 0;              ///< m, side of the blocks that the mosaic is made of; 0: one
  double block_gain = 0;         ///< standard deviation of a block's gain, one for each colour
  double block_shift = 0;        ///< texels, standard deviation of a block's shift along x and y
  double light = 0;              ///< 0 to 1: how much of the shading is that of another sun, with cast shadows
  double azimuth = 0;            ///< rad from north, clockwise, of this sun
  double elevation = 0.8;        ///< rad above the horizon
  int cars = 0;                  ///< on the mosaic alone, per hectare
  double cloud = 0;              ///< m, radius of a cloud near the middle; 0: none
  std::optional<Dates> dates{};  ///< none: both show the same day
};

/// Defects of usual maps: the mosaic is 2 to 6 times coarser than pixels of `pixel` m on the ground.
MapDefects draw_defects(uint64_t seed, double pixel);
/// The same, with a map of another season, without snow. Maps are taken around noon, frames at any hour.
MapDefects draw_season(uint64_t seed, double pixel);

/// The map of this ground, which has the date of the map already.
Terrain degraded(const Terrain& ground, const MapDefects& defects);

nlohmann::ordered_json to_json(const MapDefects& defects);

}  // namespace iclk
