#version 460
// Replaces the residuals of residual.comp by the robust weights of a level. iterate.comp includes the same step.
// Groups: (pairs, 1, 1), one workgroup per pair.
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint BLOCK = 32;  // elements: four per lane of the sums
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer Pairs { PairInfo pairs[]; };
layout(set = 0, binding = 2, std430) buffer Weights { vec4 weights[]; };
layout(set = 0, binding = 3, std430) buffer States { PairState states[]; };
layout(push_constant) uniform Push { IteratePush push; };
#include "align/weights.glsl"

void main() {
  uint pair = gl_WorkGroupID.x, lane = gl_LocalInvocationIndex, lanes = gl_WorkGroupSize.x;
  if (pairs[pair].enabled == 0u) return;
  uint count = (levels[push.level].element_count + BLOCK - 1u) / BLOCK * (BLOCK / 4u), first = pair * (push.weight_stride / 4u);
  for (uint k = lane; k < count; k += lanes) {
    vec4 m = weights[first + k];
    count_below(m.x);
    count_below(m.y);
    count_below(m.z);
    count_below(m.w);
  }
  float scale = scale_of(first, count);
  weigh(first, count, scale);
  if (lane == 0u) states[pair].scale[push.level] = scale;
}
