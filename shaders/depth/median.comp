#version 460
// Median over 3x3 of the pixels that have a plane, where at least five have one: it takes out what stands alone and closes
// holes of a pixel. A slanted surface keeps its planes.
// Groups: (ceil(width height / local size), 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
#include "texels.glsl"
TEXELS(0, float, planes)
layout(set = 0, binding = 1, std430) writeonly buffer Smooth { float smooth_planes[]; };
layout(push_constant) uniform Push { DepthPush push; };

void main() {
  uint k = gl_GlobalInvocationID.x;
  if (k >= push.width * push.height) return;
  ivec2 at = ivec2(k % push.width, k / push.width), last = ivec2(push.width, push.height) - 1;
  float sorted[9];
  int count = 0;
  for (int v = -1; v <= 1; ++v)
    for (int u = -1; u <= 1; ++u) {
      ivec2 to = clamp(at + ivec2(u, v), ivec2(0), last);
      float value = TEXEL(planes, to.y * int(push.width) + to.x).x;
      if (value < 0.0) continue;
      int place = count++;
      for (; place > 0 && sorted[place - 1] > value; --place) sorted[place] = sorted[place - 1];
      sorted[place] = value;
    }
  float own = TEXEL(planes, int(k)).x;
  smooth_planes[k] = count >= 5 ? sorted[count / 2] : own;
}
