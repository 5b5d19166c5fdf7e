#version 460
// One evaluation of the sums of the normal equations, as partial sums: each workgroup sums a slice of a pair's elements. The
// host solver adds them on the host, the device solver in lm_step.comp, both in the order of the slices.
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
layout(set = 0, binding = 6, std430) readonly buffer Weights { vec4 weights[]; };
layout(set = 0, binding = 7, std430) readonly buffer States { PairState states[]; };
layout(set = 0, binding = 8, std430) writeonly buffer Parts { vec4 parts[]; };
layout(push_constant) uniform Push { IteratePush push; };
#include "se3.glsl"
#include "align/level.glsl"
#include "align/residual.glsl"
#include "align/normal_equations.glsl"
#include "align/pair.glsl"

void main() {
  uint pair = gl_WorkGroupID.y;
  if (pairs[pair].enabled == 0u) return;
  View view = view_of(pair);
  bool given = (push.flags & ICLK_FLAG_GIVEN) != 0u, ends = (push.flags & ICLK_FLAG_END) != 0u;
  if (!given && !ends && push.iterations > 0u && states[pair].done != 0u) return;
  set_point(view, pair);
  uint begin = gl_WorkGroupID.x * push.group_elements;
  uint end = min(begin + push.group_elements, levels[push.level].element_count);
  clear_sums();
  add_elements(view, begin, end);
  reduce_sums();
  if (gl_LocalInvocationIndex == 0u) {
    uint at = (pair * push.groups + gl_WorkGroupID.x) * ICLK_SUM_VECTORS;
    ICLK_STORE_SUMS(parts, at)
  }
}
