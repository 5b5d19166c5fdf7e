#version 460
// Costs along one of the eight paths of semi-global matching (Hirschmueller 2008): L(p, d) = C(p, d) - min L(p - r) + min(L(p -
// r, d), L(p - r, d +- 1) + p1, min L(p - r) + p2). p2 is smaller where grey values change.
//
// One invocation per path, with the costs of its last pixel in registers: no shared memory, no barrier. Slanted paths wrap
// around at the left and right border and restart there, so that all have the same length.
// Groups: (ceil(lines / local size), 1, 1), lines = dv == 0 ? rows : width.
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint QUADS = 8;
#include "depth/words.glsl"
#include "texels.glsl"
QUADS_OF(0, costs)
TEXELS(1, float, grey)
layout(set = 0, binding = 2, std430) writeonly buffer Path { uvec4 path[]; };
layout(push_constant) uniform Push { DepthPush push; };

uint least(uvec4 v) { return min(min(v.x, v.y), min(v.z, v.w)); }

// Costs of the previous pixel minus its least cost: of the four planes before the current ones, and of the current four.
uvec4 last, own;
uvec4 lowest_four;

uint step_on(uint costs_here, uint next_word, uint p2) {
  uvec4 next = unpack(next_word), c = unpack(costs_here);
  uvec4 beside = min(uvec4(last.w, own.xyz), uvec4(own.yzw, next.x)) + push.p1;
  c += min(min(own, beside), uvec4(p2));
  last = own, own = next;
  lowest_four = min(lowest_four, c);
  return pack(c);
}

void main() {
  uint line = gl_GlobalInvocationID.x;
  bool level = push.dv == 0;
  int width = int(push.width), rows = int(push.rows), length = level ? width : rows;
  if (line >= (level ? push.rows : push.width)) return;
  ivec2 at = level ? ivec2(push.du > 0 ? 0 : width - 1, line) : ivec2(line, push.dv > 0 ? 0 : rows - 1);
  uvec4 previous[QUADS];
  for (uint quad = 0u; quad < QUADS; ++quad) previous[quad] = uvec4(0);
  uint lowest = 0u;
  float before = 0.0;
  bool begin = true;
  for (int i = 0; i < length; ++i) {
    int pixel = at.y * width + at.x;
    float now = 255.0 * clamp(TEXEL(grey, int(push.strip) * width + pixel).x, 0.0, 1.0);
    uint loss = uint(push.edge * abs(now - before));
    uint p2 = begin ? 0u : max(push.p1 + 1u, push.p2 - min(loss, push.p2));
    before = now;
    uint four_lowest = lowest * 0x01010101u;  // no byte of the minuend is smaller
    uint first = uint(pixel) * QUADS;
    last = uvec4(255u), own = unpack(previous[0].x - four_lowest), lowest_four = uvec4(255u);
    for (uint quad = 0u; quad < QUADS; ++quad) {
      uvec4 C = QUAD(costs, int(first + quad)), old = previous[quad] - four_lowest, L;
      uint beyond = quad + 1u < QUADS ? previous[min(quad + 1u, QUADS - 1u)].x - four_lowest : 0xffffffffu;
      L.x = step_on(C.x, old.y, p2);
      L.y = step_on(C.y, old.z, p2);
      L.z = step_on(C.z, old.w, p2);
      L.w = step_on(C.w, beyond, p2);
      previous[quad] = L;
      path[first + quad] = L;
    }
    lowest = least(lowest_four);
    begin = false;
    at += ivec2(push.du, push.dv);
    if (!level && (at.x < 0 || at.x >= width)) {
      at.x = at.x < 0 ? width - 1 : 0;
      begin = true;
    }
  }
}
