#version 460
// Disables pairs whose reference has too few features. The host cannot do it if the device chooses the features.
// Groups: (ceil(pairs / 64), 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x = ICLK_CHOOSE_GROUP) in;
layout(set = 0, binding = 0, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 1, std430) buffer Pairs { PairInfo pairs[]; };
layout(push_constant) uniform Push { ChosenPush push; };

void main() {
  uint pair = gl_GlobalInvocationID.x;
  if (pair < push.pairs && references[pairs[pair].reference].usable < push.least) pairs[pair].enabled = 0u;
}
