#version 460
// Residuals with which a level starts, for its M-estimator weights; 3e38 where a pixel is not in the mask or not visible.
// Groups: (ceil(element_count / local size), pairs, 1).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 2, std430) readonly buffer Pairs { PairInfo pairs[]; };
layout(set = 0, binding = 3) uniform samplerBuffer template_a;
layout(set = 0, binding = 4) uniform samplerBuffer template_b;
layout(set = 0, binding = 5) uniform samplerBuffer maps1;
layout(set = 0, binding = 6, std430) readonly buffer Unused { float weights[]; };
layout(set = 0, binding = 7, std430) readonly buffer States { PairState states[]; };
layout(set = 0, binding = 8, std430) writeonly buffer Residuals { float residuals[]; };
layout(push_constant) uniform Push { IteratePush push; };
#include "se3.glsl"
#include "level.glsl"
#include "residual.glsl"
#include "pair.glsl"

void main() {
  uint pair = gl_WorkGroupID.y, k = gl_GlobalInvocationID.x;
  if (pairs[pair].enabled == 0u || k >= levels[push.level].element_count) return;
  View view = view_of(pair);
  set_point(view, pair);
  bool visible;
  float r = residual_at(view, texelFetch(template_a, view.template_base + int(k)), visible);
  residuals[view.weight_base + k] = visible ? r : 3e38;
}
