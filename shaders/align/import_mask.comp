#version 460
// Copies a mask of the application to the alpha of existing pixels: 0 where the mask's first channel is 0, else opaque.
// Groups: (ceil(width / 64), height, 1).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_samplerless_texture_functions : require
#include "shared.h"
layout(local_size_x = 64) in;
layout(constant_id = 1) const bool FLOATS = false;  // RGBA32F, else four bytes
layout(set = 0, binding = 0) uniform texture2D mask;
layout(set = 0, binding = 1, std430) buffer Pixels { uint words[]; };
layout(push_constant) uniform Push { ImportPush push; };

void main() {
  uvec2 p = gl_GlobalInvocationID.xy;
  if (p.x >= push.width) return;
  bool seen = texelFetch(mask, ivec2(p), 0).x != 0.0;
  uint pixel = p.y * push.row_pixels + p.x;
  if (FLOATS) {
    words[push.first_word + 4u * pixel + 3u] = seen ? 0x3f800000u : 0u;
  } else {
    uint at = push.first_word + pixel;
    words[at] = seen ? words[at] | 0xff000000u : words[at] & 0x00ffffffu;
  }
}
