#version 460
// Hides pixels of targets' maps that cover pixels with an alpha of 0; HidePush.
// Groups: (ceil(width / local size), height, targets).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const bool FLOATS = false;  // RGBA32F, else four bytes
layout(set = 0, binding = 0, std430) readonly buffer Pixels { uint pixels[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Maps { float maps[]; };
layout(push_constant) uniform Push { HidePush push; };

void main() {
  uint x = gl_GlobalInvocationID.x, y = gl_WorkGroupID.y, image = push.first_image + gl_WorkGroupID.z;
  uint scale = push.scale, row = push.row_pixels, base = image * push.pixel_words, first = (y * row + x) * scale;
  if (x >= push.width) return;
  bool hidden = false;
  for (uint v = 0u; v < scale; ++v)
    for (uint u = 0u; u < scale; ++u) {
      uint pixel = first + v * row + u;
      hidden = hidden || (FLOATS ? pixels[base + 4u * pixel + 3u] << 1 : pixels[base + pixel] >> 24) == 0u;  // -0 is 0
    }
  if (hidden) maps[image * push.map_stride + push.offset + y * push.pitch + x] = ICLK_HIDDEN;
}
