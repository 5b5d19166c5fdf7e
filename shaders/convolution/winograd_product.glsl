// Winograd F(N x N, 3 x 3), second of two parts: see winograd_sums.glsl.
// Groups: (blocks of eight output channels, ceil(tiles / ICLK_WINOGRAD_TILES / local size), 1).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "network/network.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer transformed;
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer weights;
#include "convolution/winograd_push.glsl"
#include "convolution/winograd_tile.glsl"
#include "convolution/winograd_sums.glsl"

void main() {
  push = constants;
  int first = int(gl_WorkGroupID.y * gl_WorkGroupSize.x) * T + int(gl_LocalInvocationIndex);
  multiply(gl_WorkGroupID.x, int(push.strip), first, first);
}
