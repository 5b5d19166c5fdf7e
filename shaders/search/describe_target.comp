#version 460
// Descriptors of all places of the targets' grey maps. Groups: (ceil(places / local size), 1, targets).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "texels.glsl"
layout(local_size_x_id = 0) in;
TEXELS(0, float, grey)
layout(set = 0, binding = 1, std430) writeonly buffer Descriptors { vec4 descriptors[]; };
layout(push_constant) uniform Push { MatchPush push; };
#include "search/match_descriptor.glsl"

float at(int k) { return TEXEL(grey, k).x; }

void main() {
  int width = int(push.width), places_x = width - ICLK_PATCH + 1, places = places_x * (int(push.height) - ICLK_PATCH + 1);
  int k = int(gl_GlobalInvocationID.x), image = int(gl_WorkGroupID.z);
  if (k >= places) return;
  int first = image * width * int(push.height) + k / places_x * width + k % places_x;
  Descriptor d;
#define FETCH_ROW(r, a, b)                                                                                   \
  a = vec4(at(first + r * width), at(first + r * width + 1), at(first + r * width + 2), at(first + r * width + 3)); \
  b = vec4(at(first + r * width + 4), at(first + r * width + 5), at(first + r * width + 6), at(first + r * width + 7));
  DESCRIBE(d)
  int to = (image * places + k) * ICLK_MATCH_TEXELS;
  descriptors[to] = d.t0;
  descriptors[to + 1] = d.t1;
  descriptors[to + 2] = d.t2;
  descriptors[to + 3] = d.t3;
}
