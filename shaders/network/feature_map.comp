#version 460
// End of an encoder level: the feature map is the mean over the channels; the next level's input is the 2x2 means of each
// channel, sizes floored. An invocation makes a 2x2 block.
// Groups: (ceil(ceil(width / 2) / local size), ceil(height / 2), images).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "network/network.h"
layout(local_size_x_id = 0) in;
#define IN_BINDING 0
#define OUT_BINDING 2
#include "network/activations.glsl"
layout(push_constant) uniform Push { FeatureMapPush push; };
#include "network/feature_map.glsl"

void main() {
  uint x = gl_GlobalInvocationID.x, y = gl_WorkGroupID.y, image = gl_WorkGroupID.z;
  bool right = 2u * x + 1u < push.width, below = 2u * y + 1u < push.height, halves = push.halves != 0u && right && below;
  int pitch = int(push.in_pitch);
  int at = int(push.in_offset + image * push.in_image + 2u * y * push.in_pitch + 2u * x);
  uint to = push.out_offset + image * push.out_image + y * push.out_pitch + x;
  // Push constants are read before branches diverge, see docs/explain/convolutions.md.
  int in_plane = int(push.in_plane);
  uint out_plane = push.out_plane, planes = push.in_planes, c = 0u;
  Block block = block_at(x, y, image);
  if (2u * x >= push.width) return;
  vec4 sum[4] = vec4[](vec4(0.0), vec4(0.0), vec4(0.0), vec4(0.0));
  do {
    // The border is beyond the last row and column.
    vec4 a = TEXEL(activations, at), b = TEXEL(activations, at + 1);
    vec4 d = TEXEL(activations, at + pitch), e = TEXEL(activations, at + pitch + 1);
    sum[0] += a;
    sum[1] += b;
    sum[2] += d;
    sum[3] += e;
    if (halves) put(to, 0.25 * ((a + b) + (d + e)));
    at += in_plane;
    to += out_plane;
  } while (++c < planes);
  vec4 channels;
  [[unroll]] for (uint k = 0u; k < 4u; ++k) channels[k] = (sum[k].x + sum[k].y) + (sum[k].z + sum[k].w);
  write_block(block, channels);
}
