#version 460
// Dense mode: the mask of a level from the inverse depth of the next finer one (align/solver/mask.h: half_inverse_depth). At
// level 0, values of the host that are not finite or not positive become 0.
// Groups: (ceil(element_count / local size), 1, references).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) buffer Mask { float mask[]; };
layout(push_constant) uniform Push { JacobianPush push; };

void main() {
  LevelInfo to = levels[push.level];
  uint k = gl_GlobalInvocationID.x;
  if (k >= to.element_count) return;
  uint base = (push.first_reference + gl_WorkGroupID.z) * push.element_stride;
  if (push.level == 0u) {
    float q = mask[base + k];
    mask[base + k] = q > 0.0 && q < 3e38 ? q : 0.0;  // false for NaN
    return;
  }
  LevelInfo from = levels[push.level - 1u];
  uint at = base + from.element_offset + 2u * (k / to.width) * from.width + 2u * (k % to.width);
  vec4 q = vec4(mask[at], mask[at + 1u], mask[at + from.width], mask[at + from.width + 1u]);
  bvec4 valid = greaterThan(q, vec4(0.0));
  float n = dot(vec4(valid), vec4(1.0));
  vec4 low = mix(vec4(1e30), q, valid);  // selected, not blended: 1e30 + (q - 1e30) is 0
  float least = min(min(low.x, low.y), min(low.z, low.w)), most = max(max(q.x, q.y), max(q.z, q.w));
  mask[base + to.element_offset + k] = n > 0.0 && most <= 1.1 * least ? ((q.x + q.y) + (q.z + q.w)) / n : 0.0;
}
