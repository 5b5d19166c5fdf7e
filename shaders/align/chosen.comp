#version 460
// The number and the mean inverse depth of the features that choose.comp has chosen. For given features the host computes them.
// Groups: (1, 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x = ICLK_CHOOSE_GROUP) in;
layout(set = 0, binding = 0, std430) buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 1, std430) readonly buffer FeatureList { FeatureInfo features[]; };
layout(push_constant) uniform Push { ChosenPush push; };

shared float sums[ICLK_CHOOSE_GROUP];
shared uint counts[ICLK_CHOOSE_GROUP];

void main() {
  uint lane = gl_LocalInvocationID.x, count = references[push.reference].feature_count;
  float sum = 0.0;
  uint usable = 0u;
  for (uint i = lane; i < count; i += ICLK_CHOOSE_GROUP) {
    float q = features[push.first_feature + i].inverse_depth;
    sum += q;
    usable += q > 0.0 ? 1u : 0u;
  }
  sums[lane] = sum;
  counts[lane] = usable;
  barrier();
  if (lane != 0u) return;
  for (uint i = 1u; i < ICLK_CHOOSE_GROUP; ++i) {
    sum += sums[i];
    usable += counts[i];
  }
  references[push.reference].mean_inverse_depth = usable > 0u ? sum / float(usable) : 0.0;
  references[push.reference].usable = usable;
}
