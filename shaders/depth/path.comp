#version 460
// Costs along one of the eight paths of semi-global matching (Hirschmueller 2008): L(p, d) = C(p, d) - min L(p - r) +
// min(L(p - r, d), L(p - r, d +- 1) + p1, min L(p - r) + p2). p2 is less where grey values change.
//
// An invocation is a path, with the costs of its last pixel in registers: no shared memory, no barrier. Along a slanted path it
// wraps round at the left and right border and begins anew there, so that all have the same length.
// Groups: (ceil(lines / local size), 1, 1), lines = dv == 0 ? height : width.
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint WORDS = 32;
#include "depth/words.glsl"
#include "texels.glsl"
WORDS_OF(0, costs)
TEXELS(1, float, grey)
layout(set = 0, binding = 2, std430) writeonly buffer Path { uint path[]; };
layout(push_constant) uniform Push { DepthPush push; };

uint least(uvec4 v) { return min(min(v.x, v.y), min(v.z, v.w)); }

void main() {
  uint line = gl_GlobalInvocationID.x;
  bool level = push.dv == 0;
  int width = int(push.width), height = int(push.height), length = level ? width : height;
  if (line >= (level ? push.height : push.width)) return;
  ivec2 at = level ? ivec2(push.du > 0 ? 0 : width - 1, line) : ivec2(line, push.dv > 0 ? 0 : height - 1);
  uint previous[WORDS];
  uint lowest = 0u;
  float before = 0.0;
  bool begin = true;
  for (int i = 0; i < length; ++i) {
    int pixel = at.y * width + at.x;
    float now = 255.0 * clamp(TEXEL(grey, pixel).x, 0.0, 1.0);
    uint loss = uint(push.edge * abs(now - before));
    uint p2 = max(push.p1 + 1u, push.p2 - min(loss, push.p2));
    before = now;
    uint next_lowest = 255u, ceiling = lowest + p2;
    uint first = uint(pixel) * WORDS;
    uvec4 last = uvec4(255u), own = begin ? uvec4(0u) : unpack(previous[0]);
    for (uint word = 0u; word < WORDS; ++word) {
      uvec4 next = word + 1u < WORDS ? unpack(previous[min(word + 1u, WORDS - 1u)]) : uvec4(255u);
      uvec4 c = unpack(WORD(costs, int(first + word)));
      if (!begin) {
        uvec4 beside = min(uvec4(last.w, own.xyz), uvec4(own.yzw, next.x)) + push.p1;
        c += min(min(own, beside), uvec4(ceiling)) - lowest;
      }
      last = own;
      own = next;
      uint packed = pack(c);
      previous[word] = packed;
      path[first + word] = packed;
      next_lowest = min(next_lowest, least(c));
    }
    lowest = next_lowest;
    begin = false;
    at += ivec2(push.du, push.dv);
    if (!level && (at.x < 0 || at.x >= width)) {
      at.x = at.x < 0 ? width - 1 : 0;
      begin = true;
    }
  }
}
