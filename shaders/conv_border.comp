#version 460
// Zero border of every plane of activations: right of each row, which is left of the next one, and below, which is above the
// next plane. Plane 0 of the dispatch is what lies before the first plane.
// Groups: (ceil((height + pitch) width / local size), 1 + planes of all images, 1).
#extension GL_GOOGLE_include_directive : require
#include "network.h"
layout(local_size_x_id = 0) in;
#define OUT_BINDING 0
#include "activations.glsl"
layout(push_constant) uniform Push { BorderPush push; };

void main() {
  uint id = gl_GlobalInvocationID.x, right = push.height * push.width;
  if (id >= right + push.width * push.pitch) return;
  if (gl_WorkGroupID.y == 0u && id < right - push.width) return;
  uint at = id < right ? (id / push.width) * push.pitch + (push.pitch - push.width) + id % push.width
                       : push.height * push.pitch + (id - right);
  put(push.offset + gl_WorkGroupID.y * push.plane + at - push.plane, vec4(0.0));
}
