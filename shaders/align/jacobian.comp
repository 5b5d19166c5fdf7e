#version 460
// The template of a reference: position, inverse depth, f0 and central differences of each mask pixel. The iterations compute
// the Jacobian from these (align/solver/jacobian.h). Sparse mode: element feature * 64 + patch pixel, one invocation per row of
// a patch. Dense mode: element v * width + u, one invocation each.
// Groups: (ceil(element_count / 8 or 1 / local size), levels, references).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "shared.h"
#include "texels.glsl"
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const bool DENSE = false;
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer FeatureList { vec4 features[]; };
layout(set = 0, binding = 2, std430) readonly buffer Mask { float mask[]; };    // dense mode: inverse depth of an element
layout(set = 0, binding = 2, std430) readonly buffer MaskRows { uvec2 rows[]; };  // sparse mode: mask.comp
TEXELS(3, float, maps0)
layout(set = 0, binding = 4, std430) writeonly buffer TemplateA { vec4 template_a[]; };  // u, v, inverse depth, f0
layout(set = 0, binding = 5, std430) writeonly buffer TemplateB { vec4 template_b[]; };  // gu, gv
layout(push_constant) uniform Push { JacobianPush push; };

float f0(int at) { return TEXEL(maps0, at).x; }

void dense_pixel(LevelInfo info, int base, uint at, uint k) {
  vec4 a = vec4(0.0), b = vec4(0.0);
  float q = mask[at + k];
  if (q > 0.0) {
    ivec2 pixel = ivec2(k % info.width, k / info.width);
    int pitch = int(info.pitch), row = base + pixel.y * pitch;
    int left = max(pixel.x - 1, 0), right = min(pixel.x + 1, int(info.width) - 1);
    int above = base + max(pixel.y - 1, 0) * pitch, below = base + min(pixel.y + 1, int(info.height) - 1) * pitch;
    a = vec4(vec2(pixel), q, f0(row + pixel.x));
    b.x = 0.5 * (f0(row + right) - f0(row + left));
    b.y = 0.5 * (f0(below + pixel.x) - f0(above + pixel.x));
  }
  template_a[at + k] = a;
  template_b[at + k] = b;
}

void patch_row(LevelInfo info, int base, uint at, uint k, uint level, uint reference) {
  vec4 feature = features[reference * push.max_features + k / ICLK_PATCH];
  vec2 c = (feature.xy + 0.5) / float(1u << level) - 0.5;
  ivec2 first = ivec2(floor(c)) - ICLK_PATCH_BEFORE + ivec2(0, k % ICLK_PATCH);
  uvec2 words = rows[at / ICLK_PATCH + k];
  // The mask of an unused feature is not written.
  uint bits = feature.z > 0.0 ? words.x | words.y : 0u;
  ivec2 last = ivec2(info.width, info.height) - 1;
  // A row outside the image has no bits; it reads a valid address.
  int pitch = int(info.pitch), row = base + clamp(first.y, 0, last.y) * pitch;
  int above = base + clamp(first.y - 1, 0, last.y) * pitch, below = base + clamp(first.y + 1, 0, last.y) * pitch;
  float before = f0(row + clamp(first.x - 1, 0, last.x)), here = f0(row + clamp(first.x, 0, last.x));
  at += k * ICLK_PATCH;
  [[unroll]] for (int i = 0; i < ICLK_PATCH; ++i) {
    int u = clamp(first.x + i, 0, last.x);
    float after = f0(row + clamp(first.x + i + 1, 0, last.x));
    bool mine = (bits & (1u << i)) != 0u;
    vec4 a = vec4(float(first.x + i), float(first.y), feature.z, here);
    vec2 b = 0.5 * vec2(after - before, f0(below + u) - f0(above + u));
    template_a[at + i] = mine ? a : vec4(0.0);
    template_b[at + i] = mine ? vec4(b, 0.0, 0.0) : vec4(0.0);
    before = here;
    here = after;
  }
}

void main() {
  uint level = push.level + gl_WorkGroupID.y, reference = push.first_reference + gl_WorkGroupID.z;
  LevelInfo info = levels[level];
  uint k = gl_GlobalInvocationID.x;
  if (k >= info.element_count / (DENSE ? 1u : ICLK_PATCH)) return;
  int base = int(reference * push.map_stride + info.map_offset);
  uint at = reference * push.element_stride + info.element_offset;
  if (DENSE) dense_pixel(info, base, at, k);
  else patch_row(info, base, at, k, level, reference);
}
