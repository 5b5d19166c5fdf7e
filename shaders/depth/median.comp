#version 460
// The median over 3x3 pixels with a plane, if at least five have one. It removes isolated values and closes holes of one pixel.
// A slanted surface keeps its planes.
// Groups: (ceil(width height / local size), 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
#include "texels.glsl"
TEXELS(0, float, planes)
layout(set = 0, binding = 1, std430) writeonly buffer Smooth { float smooth_planes[]; };
layout(push_constant) uniform Push { DepthPush push; };

const float NONE = 1e9;  // larger than all planes

void order(inout float a, inout float b) {
  float least = min(a, b);
  b = max(a, b);
  a = least;
}

void main() {
  uint k = gl_GlobalInvocationID.x;
  if (k >= push.width * push.height) return;
  ivec2 at = ivec2(k % push.width, k / push.width), last = ivec2(push.width, push.height) - 1;
  float s[9];
  int count = 0;
  for (int i = 0; i < 9; ++i) {
    ivec2 to = clamp(at + ivec2(i % 3, i / 3) - 1, ivec2(0), last);
    float value = TEXEL(planes, to.y * int(push.width) + to.x).x;
    count += int(value >= 0.0);
    s[i] = value < 0.0 ? NONE : value;
  }
  float own = s[4];
  // A sorting network with constant indices, because lavapipe is slow with variable ones. First columns, then rows.
  for (int i = 0; i < 3; ++i) order(s[i], s[i + 3]), order(s[i + 3], s[i + 6]), order(s[i], s[i + 3]);
  for (int i = 0; i < 9; i += 3) order(s[i], s[i + 1]), order(s[i + 1], s[i + 2]), order(s[i], s[i + 1]);
  order(s[1], s[3]), order(s[5], s[7]), order(s[2], s[6]), order(s[4], s[6]), order(s[2], s[4]);
  order(s[2], s[3]), order(s[5], s[6]), order(s[3], s[4]), order(s[4], s[5]);
  float middle = count >= 8 ? s[4] : count >= 6 ? s[3] : s[2];
  smooth_planes[k] = count >= 5 ? middle : own == NONE ? -1.0 : own;
}
