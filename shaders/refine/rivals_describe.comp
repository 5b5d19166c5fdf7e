#version 460
// Descriptors of the reference's patches, warped to the target. Groups: (ceil(features / 64), 1, pairs).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "refine/refine.h"
#include "texels.glsl"
layout(local_size_x = ICLK_REFINE_GROUP) in;
TEXELS(0, float, grey)
layout(set = 0, binding = 1, std430) readonly buffer Questions { PairInfo questions[]; };
layout(set = 0, binding = 2, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 3, std430) readonly buffer Sought { vec4 sought[]; };
layout(set = 0, binding = 4, std430) writeonly buffer Descriptors { vec4 descriptors[]; };
layout(push_constant) uniform Push { RivalPush push; };
#include "search/match_descriptor.glsl"
#include "search/match_sample.glsl"

void main() {
  uint match = gl_GlobalInvocationID.x, pair = gl_WorkGroupID.z, reference = questions[pair].reference;
  if (questions[pair].enabled == 0u || match >= questions[pair].search) return;
  width = int(push.width);
  height = int(push.height);
  base = int(reference) * width * height;
  uint from = (pair * push.features + match) * ICLK_ELSEWHERE_STRIDE;
  vec4 warp = sought[from + 1u];
  bool valid = sought[from].w != 0.0;
  Descriptor d = describe_at(sought[from + 2u].xy, valid ? warp.xy : vec2(1.0, 0.0), valid ? warp.zw : vec2(0.0, 1.0));
  uint to = ((pair * push.features + match) * ICLK_MATCH_ROLLS + ICLK_MATCH_ROLLS / 2) * ICLK_MATCH_TEXELS;
  descriptors[to] = valid ? d.t0 : vec4(0.0);
  descriptors[to + 1u] = valid ? d.t1 : vec4(0.0);
  descriptors[to + 2u] = valid ? d.t2 : vec4(0.0);
  descriptors[to + 3u] = valid ? d.t3 : vec4(0.0);
}
