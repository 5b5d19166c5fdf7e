#pragma once
#include <cstdint>

#include <iclk/engine/compute/memory.h>

namespace iclk::internal {

/// The place of a level's maps in floats, and the computed pixels [first, end) that are written there; the margin of a tile is
/// not. If `end_u` is the computed width, the rest of a row up to a multiple of four floats is overwritten.
struct MapPlace {
  uint32_t offset, pitch, stride;  // of pixel (0, 0), from row to row, from image to image
  uint32_t first_u, first_v, end_u, end_v;

  /// Whether rows can be written four pixels at a time. `width`: the computed width.
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

/// Images at .. at + count - 1 of a pass; their maps in `maps` are first_image .. first_image + count - 1.
struct MapPart {
  const engine::Buffer* maps;
  uint32_t at, count, first_image;
};

}  // namespace iclk::internal
