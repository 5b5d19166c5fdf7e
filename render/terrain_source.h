#pragma once
#include <memory>

#include <iclk/render/terrain.h>

namespace iclk {

/// A map of any size that is read window by window.
class TerrainSource {
 public:
  virtual ~TerrainSource() = default;
  virtual MapBox extent() const = 0;
  /// The map inside the box, with pixels of about `texel` m: of the source's own size if that is larger, and larger ones if a
  /// window would not fit into memory otherwise. Null: nothing of the map lies there.
  virtual std::shared_ptr<const Terrain> window(const MapBox& box, double texel) const = 0;
};

}  // namespace iclk
