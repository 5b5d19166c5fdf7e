#version 460
// Which of two pixels that lie opposite about a pixel is the brighter: a bit a pair, whatever gain and bias.
// Groups: (ceil(width height / local size), 1, images).
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
#include "texels.glsl"
TEXELS(0, float, grey)
layout(set = 0, binding = 1, std430) writeonly buffer Census { uint census[]; };
layout(push_constant) uniform Push { DepthPush push; };

float grey_of(int base, ivec2 at) {
  at = clamp(at, ivec2(0), ivec2(push.width, push.height) - 1);
  return TEXEL(grey, base + at.y * int(push.width) + at.x).x;
}

void main() {
  uint k = gl_GlobalInvocationID.x, area = push.width * push.height;
  if (k >= area) return;
  int base = int(gl_WorkGroupID.z * area);
  ivec2 at = ivec2(k % push.width, k / push.width);
  uint bits = 0u;
  for (int v = 0; v <= ICLK_CENSUS_RADIUS_V; ++v)
    for (int u = v == 0 ? 1 : -ICLK_CENSUS_RADIUS_U; u <= ICLK_CENSUS_RADIUS_U; ++u) {
      ivec2 offset = ivec2(u, v);
      bits = bits << 1 | uint(grey_of(base, at + offset) > grey_of(base, at - offset));
    }
  census[uint(base) + k] = bits;
}
