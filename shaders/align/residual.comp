#version 460
// Writes |r| at the start of a level, instead of the weights (weights.glsl). Each workgroup processes a slice.
// Groups: (groups, pairs, 1).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "texels.glsl"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 2, std430) readonly buffer Pairs { PairInfo pairs[]; };
TEXELS(3, vec4, template_a)
TEXELS(4, vec4, template_b)
TEXELS(5, float, maps1)
layout(set = 0, binding = 6, std430) writeonly buffer Weights { vec4 weights[]; };
layout(set = 0, binding = 7, std430) readonly buffer States { PairState states[]; };
layout(push_constant) uniform Push { IteratePush push; };
#include "se3.glsl"
#include "align/level.glsl"
#include "align/residual.glsl"
#include "align/pair.glsl"

void main() {
  uint pair = gl_WorkGroupID.y, count = levels[push.level].element_count, lane = gl_LocalInvocationIndex;
  if (pairs[pair].enabled == 0u) return;
  View view = view_of(pair);
  set_point(view, pair);
  uint begin = gl_WorkGroupID.x * push.group_elements, end = min(begin + push.group_elements, count);
  for (uint block = begin; block < end; block += 4u * gl_WorkGroupSize.x)
    weights[view.weight_base + block / 4u + lane] = magnitudes_at(view, block + lane, count);
}
