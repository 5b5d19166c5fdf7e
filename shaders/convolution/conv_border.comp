#version 460
// Writes the zero border of every plane of activations: right of each row (left of the next row) and below (above the next
// plane). Plane 0 of the dispatch is the border before the first plane. Two buffers have planes of the same layout.
// Groups: (ceil((height + pitch) width / local size), 1 + planes of all images, 2).
#extension GL_GOOGLE_include_directive : require
#include "network/network.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) writeonly buffer First { vec4 first[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Second { vec4 second[]; };
layout(push_constant) uniform Push { BorderPush push; };

void main() {
  uint id = gl_GlobalInvocationID.x, right = push.height * push.width;
  uint planes = push.planes[gl_WorkGroupID.z];
  if (planes == 0u || gl_WorkGroupID.y > planes || id >= right + push.width * push.pitch) return;
  if (gl_WorkGroupID.y == 0u && id < right - push.width) return;
  uint at = id < right ? (id / push.width) * push.pitch + (push.pitch - push.width) + id % push.width
                       : push.height * push.pitch + (id - right);
  at += push.offset + gl_WorkGroupID.y * push.plane - push.plane;
  if (gl_WorkGroupID.z == 0u)
    first[at] = vec4(0.0);
  else
    second[at] = vec4(0.0);
}
