// Patches of features and their warps, for feature_alignment.comp and colour_sums.comp. One workgroup per feature, one
// invocation per row of its 8x8 patch.
#include "shared.h"
#include "refine/refine.h"
#include "texels.glsl"
#include "align/level.glsl"
#include "se3.glsl"
#include "refine/warp.glsl"
layout(local_size_x = ICLK_PATCH) in;

layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 2, std430) readonly buffer Tasks { FeatureTask tasks[]; };
layout(set = 0, binding = 3, std430) readonly buffer FeatureList { FeatureInfo features[]; };
TEXELS(4, float, fine0)  // level 0
TEXELS(5, float, fine1)
TEXELS(6, float, maps0)  // the others
TEXELS(7, float, maps1)
layout(push_constant) uniform Push { FeatureAlignmentPush push; };

const uint ALIGNED = 0, DIVERGED = 1, OUT_OF_IMAGE = 2, LOW_TEXTURE = 3, BAD_MATCH = 4, REJECTED = 5,
           HIDDEN = 6;  // FeatureStatus
const float CENTRE = 0.5 * (ICLK_PATCH - 1);
const float AREA = ICLK_PATCH_AREA;

shared vec4 rows_a[ICLK_PATCH], rows_b[ICLK_PATCH];
int row;

// Sums over the rows of the patch, in their order.
void sum_rows(inout vec4 a, inout vec4 b) {
  rows_a[row] = a;
  rows_b[row] = b;
  barrier();
  a = vec4(0.0);
  b = vec4(0.0);
  [[unroll]] for (int k = 0; k < ICLK_PATCH; ++k) {
    a += rows_a[k];
    b += rows_b[k];
  }
  barrier();
}

// A map: where it begins, its pitch, its last pixel, and (known when compiled) the buffer.
struct MapView {
  int base, pitch;
  ivec2 last;
  bool fine;
};

MapView map_view(uint image, uint level) {
  LevelInfo info = levels[level];
  uint base = level == 0u ? image * push.fine_stride : image * push.map_stride + info.map_offset;
  return MapView(int(base), int(info.pitch), ivec2(info.width, info.height) - 1, level == 0u);
}

float fetch0(MapView m, int at) {
  if (m.fine) return TEXEL(fine0, at).x;
  return TEXEL(maps0, at).x;
}

float fetch1(MapView m, int at) {
  if (m.fine) return TEXEL(fine1, at).x;
  return TEXEL(maps1, at).x;
}

float bilinear0(MapView m, vec2 p) {
  p = clamp(p, vec2(0.0), vec2(m.last));
  ivec2 corner = clamp(ivec2(p), ivec2(0), m.last - 1);  // as integers, so that a NaN reads a valid address
  vec2 f = p - vec2(corner);
  int at = m.base + corner.y * m.pitch + corner.x;
  vec2 top = vec2(fetch0(m, at), fetch0(m, at + 1));
  vec2 bottom = vec2(fetch0(m, at + m.pitch), fetch0(m, at + m.pitch + 1));
  vec2 left_right = mix(top, bottom, f.y);
  return mix(left_right.x, left_right.y, f.x);
}

PatchWarp warp_patch(FeatureInfo feature, FeatureTask task) {
  return warp_patch(feature, references[task.reference], pose_of(task.pose));
}
