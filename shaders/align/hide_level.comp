#version 460
// Hides pixels of a level of targets' maps that cover hidden pixels of the next finer level; HidePush.
// Groups: (ceil(width / local size), height, targets).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) buffer Maps { float maps[]; };
layout(push_constant) uniform Push { HidePush push; };

void main() {
  uint u = gl_GlobalInvocationID.x, v = gl_WorkGroupID.y, pitch = push.finer_pitch;
  uint base = (push.first_image + gl_WorkGroupID.z) * push.map_stride;
  if (u >= push.width) return;
  uint from = base + push.finer_offset + 2u * v * pitch + 2u * u;
  float most = max(max(maps[from], maps[from + 1u]), max(maps[from + pitch], maps[from + pitch + 1u]));
  if (most > ICLK_HIDDEN_FROM) maps[base + push.offset + v * push.pitch + u] = ICLK_HIDDEN;
}
