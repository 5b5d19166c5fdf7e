#version 460
// Descriptors of a reference's features for every roll: 8x8 values around the feature, in the grid of the rolled image. Groups:
// (ceil(features rolls / local size), 1, references).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "texels.glsl"
layout(local_size_x_id = 0) in;
TEXELS(0, float, grey)
layout(set = 0, binding = 1, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 2, std430) readonly buffer FeatureList { vec4 features[]; };
layout(set = 0, binding = 3, std430) writeonly buffer Descriptors { vec4 descriptors[]; };
layout(push_constant) uniform Push { MatchPush push; };
#include "search/match_descriptor.glsl"
#include "search/match_features.glsl"

#include "search/match_sample.glsl"

void main() {
  uint k = gl_GlobalInvocationID.x, reference = push.first_reference + gl_WorkGroupID.z;
  uint match = k / ICLK_MATCH_ROLLS, roll = k % ICLK_MATCH_ROLLS;
  uint count = references[reference].feature_count;
  if (match >= min(count, push.features)) return;
  width = int(push.width);
  height = int(push.height);
  base = int(reference) * width * height;
  vec4 feature = features[reference * push.max_features + feature_of(match, count)];
  vec2 centre = (feature.xy + 0.5) / float(push.scale) - 0.5;
  float angle = (float(roll) - 0.5 * float(ICLK_MATCH_ROLLS - 1)) * ICLK_MATCH_ROLL;
  vec2 along = vec2(cos(angle), sin(angle)), down = vec2(-along.y, along.x);
  Descriptor d = describe_at(centre, along, down);
  bool usable = feature.z > 0.0;
  uint to = ((reference * push.features + match) * ICLK_MATCH_ROLLS + roll) * ICLK_MATCH_TEXELS;
  descriptors[to] = usable ? d.t0 : vec4(0.0);
  descriptors[to + 1] = usable ? d.t1 : vec4(0.0);
  descriptors[to + 2] = usable ? d.t2 : vec4(0.0);
  descriptors[to + 3] = usable ? d.t3 : vec4(0.0);
}
