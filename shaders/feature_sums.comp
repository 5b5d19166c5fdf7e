#version 460
// End of an encoder level whose last layer left sums over eight channels each (winograd_sums.glsl): the feature map is the
// mean over all. An invocation makes a 2x2 block.
// Groups: (ceil(ceil(width / 2) / local size), ceil(height / 2), images).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "network.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer Sums { vec4 sums[]; };
layout(push_constant) uniform Push { FeatureMapPush push; };
#include "feature_map.glsl"

void main() {
  uint x = gl_GlobalInvocationID.x, y = gl_WorkGroupID.y, image = gl_WorkGroupID.z;
  uint at = push.in_offset + image * push.in_image + y * push.in_pitch + x, plane = push.in_plane, planes = push.in_planes;
  Block block = block_at(x, y, image);
  if (2u * x >= push.width) return;
  vec4 sum = vec4(0.0);
  uint c = 0u;
  do {
    sum += sums[at];
    at += plane;
  } while (++c < planes);
  write_block(block, sum);
}
