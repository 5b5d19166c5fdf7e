#version 460
// One further pyramid level beyond those of pyramid.comp: 2x2 means. Groups: (ceil(width / local size), height, images).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) buffer Maps { float maps[]; };
layout(push_constant) uniform Push { HalvePush push; };

void main() {
  LevelInfo to = levels[push.level], from = levels[push.level - 1u];
  uint u = gl_GlobalInvocationID.x, v = gl_WorkGroupID.y;
  if (u >= to.width) return;
  uint base = (push.first_image + gl_WorkGroupID.z) * push.map_stride;
  uint at = base + from.map_offset + 2u * v * from.pitch + 2u * u;
  maps[base + to.map_offset + v * to.pitch + u] =
      0.25 * ((maps[at] + maps[at + 1u]) + (maps[at + from.pitch] + maps[at + from.pitch + 1u]));
}
