#version 460
// The grey map for matching: means of `scale` x `scale` raw pixels. It is used with learned models too, because the mean over
// an encoder's channels is less distinctive than grey values, even under hard light (docs/explain/start-search.md).
// Groups: (ceil(width height / local size), 1, images).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x_id = 0) in;
#include "pixels.glsl"
layout(set = 0, binding = 1, std430) writeonly buffer Grey { float grey[]; };
layout(push_constant) uniform Push { MatchPush push; };

void main() {
  uint k = gl_GlobalInvocationID.x, image = push.first_reference + gl_WorkGroupID.z;
  uint width = push.width, scale = push.scale, row_pixels = push.row_pixels, area = width * push.height;
  if (k >= area) return;
  uint base = image * push.pixel_words, first = k / width * scale * row_pixels + k % width * scale;
  float sum = 0.0;
  for (uint v = 0u; v < scale; ++v)
    for (uint u = 0u; u < scale; ++u) sum += luma(colour(base, first + v * row_pixels + u));
  grey[image * area + k] = sum / float(scale * scale);
}
