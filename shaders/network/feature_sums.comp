#version 460
// The end of an encoder level whose last layer has written sums over eight channels each (winograd_sums.glsl). The feature map
// is the mean over all channels. An invocation computes two 2x2 blocks of a row, so that four floats are stored at once.
// Groups: (ceil(ceil(width / 4) / local size), ceil(height / 2), images).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "network/network.h"
layout(local_size_x_id = 0) in;
// Rows of the map and the requested pixels begin and end at multiples of four, or end with the row.
layout(constant_id = 1) const bool WHOLE = false;
layout(set = 0, binding = 0, std430) readonly buffer Sums { vec4 sums[]; };
layout(push_constant) uniform Push { FeatureMapPush push; };
#include "network/feature_map.glsl"
layout(set = 0, binding = 1, std430) writeonly buffer MapRows { vec4 map_rows[]; };

void main() {
  uint x = 2u * gl_GlobalInvocationID.x, y = gl_WorkGroupID.y, image = gl_WorkGroupID.z;
  uint columns = push.in_pitch, plane = push.in_plane, planes = push.in_planes;
  uint at = push.in_offset + image * push.in_image + y * columns + min(x, columns - 1u), next = x + 1u < columns ? 1u : 0u;
  Block left = block_at(x, y, image), right = block_at(x + 1u, y, image);
  if (2u * x >= push.width) return;
  vec4 a = vec4(0.0), b = vec4(0.0);
  uint c = 0u;
  do {
    a += sums[at];
    b += sums[at + next];
    at += plane;
  } while (++c < planes);
  if (WHOLE) {
    bool inside = left.at.x >= left.first.x && left.at.x < left.end.x;
    a *= left.inverse_channels;
    b *= left.inverse_channels;
    if (inside && left.at.y >= left.first.y && left.at.y < left.end.y) map_rows[left.map / 4u] = vec4(a.xy, b.xy);
    if (inside && left.at.y + 1u >= left.first.y && left.at.y + 1u < left.end.y)
      map_rows[(left.map + left.pitch) / 4u] = vec4(a.zw, b.zw);
  } else {
    write_block(left, a);
    write_block(right, b);
  }
}
