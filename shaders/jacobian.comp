#version 460
// Template of a reference: for each mask pixel its place, inverse depth, f0 and central differences, from which the iterations
// form the Jacobian (align/internal/jacobian.h). Sparse mode: element = feature * 64 + patch pixel; dense mode: v * width + u.
// Groups: (ceil(element_count / local size), 1, references), one dispatch a level.
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const bool DENSE = false;
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer FeatureList { vec4 features[]; };
layout(set = 0, binding = 2, std430) readonly buffer Mask { float mask[]; };
layout(set = 0, binding = 3) uniform samplerBuffer maps0;
layout(set = 0, binding = 4, std430) writeonly buffer TemplateA { vec4 template_a[]; };  // u, v, inverse depth, f0
layout(set = 0, binding = 5, std430) writeonly buffer TemplateB { vec4 template_b[]; };  // gu, gv
layout(push_constant) uniform Push { JacobianPush push; };

void main() {
  uint level = push.level, reference = push.first_reference + gl_WorkGroupID.z;
  LevelInfo info = levels[level];
  uint k = gl_GlobalInvocationID.x;
  if (k >= info.element_count) return;
  uint at = reference * push.element_stride + info.element_offset + k;
  float q = mask[at];
  vec4 a = vec4(0.0), b = vec4(0.0);
  if (q > 0.0) {
    ivec2 pixel;
    if (DENSE) {
      pixel = ivec2(k % info.width, k / info.width);
    } else {
      vec2 c = (features[reference * push.max_features + k / ICLK_PATCH_AREA].xy + 0.5) / float(1u << level) - 0.5;
      pixel = ivec2(floor(c)) - ICLK_PATCH_BEFORE + ivec2(k % ICLK_PATCH, (k / ICLK_PATCH) % ICLK_PATCH);
    }
    int base = int(reference * push.map_stride + info.map_offset), pitch = int(info.pitch);
    int row = base + pixel.y * pitch;
    int left = max(pixel.x - 1, 0), right = min(pixel.x + 1, int(info.width) - 1);
    int above = base + max(pixel.y - 1, 0) * pitch, below = base + min(pixel.y + 1, int(info.height) - 1) * pitch;
    a = vec4(vec2(pixel), q, texelFetch(maps0, row + pixel.x).x);
    b.x = 0.5 * (texelFetch(maps0, row + right).x - texelFetch(maps0, row + left).x);
    b.y = 0.5 * (texelFetch(maps0, below + pixel.x).x - texelFetch(maps0, above + pixel.x).x);
  }
  template_a[at] = a;
  template_b[at] = b;
}
