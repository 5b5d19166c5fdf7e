#version 460
// Computes count, mean and sum of squared deviations of the raw pixels of each invocation: some columns of a strip of rows, all
// input channels of the model together. image_light.comp merges them.
// Groups: (1, ICLK_LIGHT_STRIPS, images).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "network/network.h"
layout(local_size_x_id = 0) in;
#include "pixels.glsl"
layout(set = 0, binding = 1, std430) writeonly buffer Moments { vec4 moments[]; };
layout(push_constant) uniform Push { MomentsPush push; };

void main() {
  uint lane = gl_LocalInvocationIndex, strip = gl_WorkGroupID.y, image = gl_WorkGroupID.z;
  uint rows = (push.height + ICLK_LIGHT_STRIPS - 1u) / ICLK_LIGHT_STRIPS;
  uint first = strip * rows, end = min(first + rows, push.height);
  // Read before the loops, because lavapipe repeats slow reads of push constants in divergent code.
  uint base = (push.first_image + image) * push.pixel_stride, width = push.width, row_pixels = push.row_pixels;
  bool luma_only = CHANNELS == 1u;
  // Deviations from one of the values, so that large values lose no digits.
  float shift = FLOATS ? 0.0 : 0.5, sum = 0.0, squares = 0.0;
  uint count = 0u;
  for (uint v = first; v < end; ++v)
    for (uint u = lane; u < width; u += gl_WorkGroupSize.x) {
      vec3 c = colour(base, v * row_pixels + u);
      if (luma_only) c = vec3(luma(c));
      vec3 size = abs(c);
      if (FLOATS) {
        bool counts = size.x < ICLK_LARGEST_PIXEL && size.y < ICLK_LARGEST_PIXEL && size.z < ICLK_LARGEST_PIXEL;
        if (!counts) continue;  // NaN does not count either
        if (count == 0u) shift = c.x;
      }
      vec3 d = c - shift;
      sum += luma_only ? d.x : d.x + d.y + d.z;
      squares += luma_only ? d.x * d.x : dot(d, d);
      ++count;
    }
  float n = float(count) * (luma_only ? 1.0 : 3.0), mean = n > 0.0 ? sum / n : 0.0;
  moments[((push.at + image) * ICLK_LIGHT_STRIPS + strip) * gl_WorkGroupSize.x + lane] =
      vec4(n, shift + mean, max(squares - sum * mean, 0.0), 0.0);
}
