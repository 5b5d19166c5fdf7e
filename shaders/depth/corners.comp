#version 460
// Packs the four pixels of a bilinear sample in one texel: the pixel with that number, the one to its right, the one below, and
// the one below to the right.
// Groups: (ceil(width height / local size), 1, images).
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
#include "texels.glsl"
TEXELS(0, float, grey)
layout(set = 0, binding = 1, std430) writeonly buffer Corners { vec4 corners[]; };
layout(push_constant) uniform Push { DepthPush push; };

void main() {
  uint k = gl_GlobalInvocationID.x, area = push.width * push.height;
  if (k >= area) return;
  uint place = gl_WorkGroupID.z * area + k;
  int width = int(push.width), at = int(place);
  int right = int(k) % width + 1 < width ? 1 : 0, down = int(k) + width < int(area) ? width : 0;
  corners[place] =
      vec4(TEXEL(grey, at).x, TEXEL(grey, at + right).x, TEXEL(grey, at + down).x, TEXEL(grey, at + down + right).x);
}
