#version 460
// Keeps pixels whose claim is confirmed by at least one view: its winner there has the same plane. Pixels that are hidden in
// every view lose their claims to the surfaces in front of them.
// Groups: (ceil(width height / local size), 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer Winners { vec2 winners[]; };
layout(set = 0, binding = 1, std430) readonly buffer Claims { uint claims[]; };
layout(set = 0, binding = 2, std140) uniform Views { DepthViews views; };
layout(set = 0, binding = 3, std430) writeonly buffer Planes { float planes[]; };
layout(push_constant) uniform Push { DepthPush push; };
#include "depth/project.glsl"

void main() {
  uint k = gl_GlobalInvocationID.x, area = push.width * push.height;
  if (k >= area) return;
  vec2 uv = vec2(k % push.width, k / push.width);
  float plane = winners[k].x, kept = -1.0;
  if (plane >= 0.0) {
    precise float w = push.first + push.step * floor(plane + 0.5);
    bool unseen = true;
    for (uint view = 0u; view < push.views; ++view) {
      int pixel = pixel_in(ray_in(view, uv), epipole_of(view), w);
      if (pixel < 0) continue;
      unseen = false;
      uint claim = claims[view * area + uint(pixel)];
      if (claim != 0xffffffffu && abs(float(claim & 0xffffu) - plane) <= push.tolerance + 0.5) kept = plane;
    }
    if (unseen && push.keep_unseen != 0u) kept = plane;
  }
  planes[k] = kept;
}
