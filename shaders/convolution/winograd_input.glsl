// Winograd F(N x N, 3 x 3), first of two parts: the transformed tiles of a strip. Output [position][plane][tile].
// Groups: (ceil(tiles / local size), input planes, 1).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "network/network.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0) uniform samplerBuffer activations;
layout(set = 0, binding = 1, std430) writeonly buffer Out { vec4 transformed_out[]; };
#include "convolution/winograd_push.glsl"
#include "convolution/winograd_tile.glsl"
#include "convolution/winograd_transform.glsl"

void main() {
  push = constants;
  uint t = gl_GlobalInvocationID.x, c = gl_WorkGroupID.y;
  if (t >= push.tiles) return;
  Tile tile = tile_at(int(push.first_tile + t));
  if (tile.image >= int(push.images)) return;
  int plane = int(push.in_offset + c * push.in_plane) + tile.image * int(push.in_image);
  transform_tile(tile, plane, int(c * push.strip + t), int(push.in_planes * push.strip));
}
