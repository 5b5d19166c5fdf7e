#pragma once
#include <cstdint>

#include <iclk/engine/compute/memory.h>

namespace iclk::internal {

/// Where the maps of a level go, and which pixels [first, end) of what is computed have one: a tile's margin has none. Floats.
/// What a row has beyond, up to a multiple of four floats, is overwritten if `end_u` is the width of what is computed.
struct MapPlace {
  uint32_t offset, pitch, stride;  // of pixel (0, 0), from row to row, from image to image
  uint32_t first_u, first_v, end_u, end_v;

  /// Rows can be written four pixels at a time. `width`: of what is computed.
  bool whole(uint32_t width) const {
    return (offset | pitch | stride | first_u) % 4 == 0 && (end_u % 4 == 0 || end_u == width);
  }
};

template <class Push>
void set_place(Push& push, const MapPlace& place) {
  push.map_offset = place.offset;
  push.map_pitch = place.pitch;
  push.map_stride = place.stride;
  push.first_u = place.first_u;
  push.first_v = place.first_v;
  push.end_u = place.end_u;
  push.end_v = place.end_v;
}

/// Images at .. at + count - 1 of a pass, whose maps are number first_image and those that follow in `maps`.
struct MapPart {
  const engine::Buffer* maps;
  uint32_t at, count, first_image;
};

}  // namespace iclk::internal
