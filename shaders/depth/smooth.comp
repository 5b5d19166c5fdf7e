#version 460
// Reduces noise between planes: a pixel gets the mean of the pixels in its window that lie on its slope. At an edge, pixels of
// the other side are left out. A wider window in the refinement instead would cross edges.
// Groups: (ceil(width height / local size), 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
#include "texels.glsl"
TEXELS(0, float, planes)
layout(set = 0, binding = 1, std430) writeonly buffer Smooth { float smooth_planes[]; };
layout(push_constant) uniform Push { DepthPush push; };
#include "depth/slope.glsl"

const float SAME = 0.5;  // largest distance from the slope, planes
const int RADIUS = 3;

void main() {
  uint k = gl_GlobalInvocationID.x;
  if (k >= push.width * push.height) return;
  ivec2 at = ivec2(k % push.width, k / push.width), last = ivec2(push.width, push.height) - 1;
  float plane = plane_at(at);
  if (plane >= 0.0) {
    vec2 gradient = slopes(at, plane);
    float sum = 0.0, count = 0.0;
    for (int v = -RADIUS; v <= RADIUS; ++v)
      for (int u = -RADIUS; u <= RADIUS; ++u) {
        ivec2 to = clamp(at + ivec2(u, v), ivec2(0), last);
        float off = plane_at(to) - plane - dot(gradient, vec2(to - at));
        if (abs(off) < SAME) sum += off, count += 1.0;
      }
    plane = max(plane + sum / count, 0.0);
  }
  smooth_planes[k] = plane;
}
