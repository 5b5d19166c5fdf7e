#version 460
// The sums of Agreement (align/solver/agreement.h), once, at the final pose of the finest level; partial sums like those of
// normal_equations.comp.
// Groups: (groups, pairs, 1).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "texels.glsl"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 2, std430) readonly buffer Pairs { PairInfo pairs[]; };
TEXELS(3, vec4, template_a)
TEXELS(4, vec4, template_b)
TEXELS(5, float, maps1)
layout(set = 0, binding = 6, std430) readonly buffer Weights { vec4 weights[]; };
layout(set = 0, binding = 7, std430) readonly buffer States { PairState states[]; };
layout(set = 0, binding = 8, std430) writeonly buffer Parts { vec4 parts[]; };
layout(push_constant) uniform Push { IteratePush push; };
#include "se3.glsl"
#include "align/level.glsl"
#include "align/residual.glsl"
#include "align/normal_equations.glsl"
#include "align/pair.glsl"

void add_gradients(View view, int k, float weight) {
  vec4 a = TEXEL(template_a, view.template_base + k);
  vec2 g0 = TEXEL(template_b, view.template_base + k).xy;
  vec2 top, bottom, f;
  vec3 p;
  bool visible;
  target_at(view, a, top, bottom, f, p, visible);
  float w = visible ? weight : 0.0;

  // The gradient of the bilinear surface, and d(warped pixel) / d(pixel) for a constant inverse depth.
  vec2 gradient = vec2(mix(top.y - top.x, bottom.y - bottom.x, f.y), mix(bottom.x - top.x, bottom.y - top.y, f.x));
  gradient = visible ? gradient : vec2(0.0);  // the value there may not be finite
  vec2 focal = vec2(view.camera.fx, view.camera.fy);
  vec3 X = visible ? p : vec3(0.0, 0.0, 1.0);
  vec2 x = X.xy / X.z;
  vec2 du = focal * (view.pose.R[0].xy - x * view.pose.R[0].z) / (X.z * focal.x);
  vec2 dv = focal * (view.pose.R[1].xy - x * view.pose.R[1].z) / (X.z * focal.y);
  vec2 g1 = vec2(dot(gradient, du), dot(gradient, dv));

  vec4 lo0, lo1;
  vec2 hi0, hi1;
  jacobian(view, a, g0, lo0, hi0);
  jacobian(view, a, g1, lo1, hi1);
  vec4 wlo0 = 0.5 * w * lo0, wlo1 = 0.5 * w * lo1;
  vec2 whi0 = 0.5 * w * hi0, whi1 = 0.5 * w * hi1;
  // Symmetric blocks: the upper triangle only, see complete_sums().
  sums[0] += wlo0.x * lo1 + wlo1.x * lo0;
  sums[1].yzw += wlo0.y * lo1.yzw + wlo1.y * lo0.yzw;
  sums[2].zw += wlo0.z * lo1.zw + wlo1.z * lo0.zw;
  sums[3].w += wlo0.w * lo1.w + wlo1.w * lo0.w;
  sums[4] += vec4(wlo0.x * hi1 + wlo1.x * hi0, wlo0.y * hi1 + wlo1.y * hi0);
  sums[5] += vec4(wlo0.z * hi1 + wlo1.z * hi0, wlo0.w * hi1 + wlo1.w * hi0);
  sums[6] += vec4(whi0.x * hi1 + whi1.x * hi0, whi0.y * hi1 + whi1.y * hi0);
  wlo1 *= 2.0;
  whi1 *= 2.0;
  sums[8] += wlo1.x * lo1;
  sums[9].yzw += wlo1.y * lo1.yzw;
  sums[10].zw += wlo1.z * lo1.zw;
  sums[11].w += wlo1.w * lo1.w;
  sums[12] += vec4(wlo1.x * hi1, wlo1.y * hi1);
  sums[13] += vec4(wlo1.z * hi1, wlo1.w * hi1);
  sums[14] += vec4(whi1.x * hi1, whi1.y * hi1);
}

ICLK_DEFINE_SUM(add_all_gradients, add_gradients)

// The weight of any element; its position follows from weights.glsl.
float weight_of(View view, uint k) {
  if (view.unit_weights) return 1.0;
  uint lanes = gl_WorkGroupSize.x, in_block = k % (4u * lanes);
  return weights[view.weight_base + (k - in_block) / 4u + in_block % lanes][in_block / lanes];
}

// Each lane processes whole patches.
void add_scores(View view, uint begin, uint end) {
  for (uint first = begin + gl_LocalInvocationIndex * ICLK_PATCH_AREA; first < end;
       first += gl_WorkGroupSize.x * ICLK_PATCH_AREA) {
    vec2 score = vec2(0.0);
    float own = 0.0, seen = 0.0;
    uint k = first, last = min(first + ICLK_PATCH_AREA, end);
    do {
      bool visible;
      float r = residual_at(view, TEXEL(template_a, view.template_base + int(k)), visible);
      vec2 s = weight_of(view, k) * r * TEXEL(template_b, view.template_base + int(k)).xy;
      if (visible) {
        score += s;
        own += dot(s, s);
        seen = 1.0;
      }
    } while (++k < last);
    sums[ICLK_SCORES] += vec4(dot(score, score), own, seen, 0.0);
  }
}

void main() {
  uint pair = gl_WorkGroupID.y;
  if (pairs[pair].enabled == 0u) return;
  View view = view_of(pair);
  set_point(view, pair);
  uint begin = gl_WorkGroupID.x * push.group_elements;
  uint end = min(begin + push.group_elements, levels[push.level].element_count);
  clear_sums();
  add_all_gradients(view, begin, end);
  add_scores(view, begin, end);
  reduce_sums();
  if (gl_LocalInvocationIndex == 0u) {
    uint at = (pair * push.groups + gl_WorkGroupID.x) * ICLK_SUM_VECTORS;
    ICLK_STORE_SUMS(parts, at)
  }
}
