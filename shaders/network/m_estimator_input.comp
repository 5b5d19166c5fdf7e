#version 460
// Input of the convolutional M-estimator: (|r|, f0, warped f1, weight of the coarser level) of every visible mask pixel,
// written to a zeroed image of the level. It has two halves, so that a buffer fits twice as many pixels. Also writes the
// residuals; 3e38 for invisible pixels.
// Groups: (ceil(element_count / local size), pairs of the pass, 1).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "texels.glsl"
#include "network/network.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 2, std430) readonly buffer Pairs { PairInfo pairs[]; };
TEXELS(3, vec4, template_a)
TEXELS(4, float, maps1)
layout(set = 0, binding = 5, std430) readonly buffer States { PairState states[]; };
layout(set = 0, binding = 6, std430) readonly buffer Prior { float prior[]; };
layout(set = 0, binding = 7, std430) writeonly buffer Residuals { float residuals[]; };
layout(set = 0, binding = 8, std430) writeonly buffer InputsA { vec2 residual_f0[]; };
layout(set = 0, binding = 9, std430) writeonly buffer InputsB { vec2 f1_prior[]; };
layout(push_constant) uniform Push { MEstimatorPush push; };
#include "se3.glsl"
#include "align/level.glsl"
#include "align/residual.glsl"
#include "align/pair.glsl"

// Bilinear by pixel areas: the borders of both grids coincide, not their outer pixel centres.
float coarser_weight(uint pair, LevelInfo info, vec2 pixel) {
  if (push.coarsest != 0u) return 1.0;
  LevelInfo coarse = levels[push.level + 1u];
  vec2 size = vec2(coarse.width, coarse.height);
  vec2 place = max((pixel + 0.5) * (size / vec2(info.width, info.height)) - 0.5, vec2(0.0));
  uvec2 first = min(uvec2(place), uvec2(size) - 1u), second = min(first + 1u, uvec2(size) - 1u);
  vec2 f = place - vec2(first);
  uint base = pair * push.prior_stride + coarse.map_offset - push.prior_origin;
  uint above = base + first.y * coarse.pitch, below = base + second.y * coarse.pitch;
  return mix(mix(prior[above + first.x], prior[above + second.x], f.x),
             mix(prior[below + first.x], prior[below + second.x], f.x), f.y);
}

void main() {
  uint pair = push.first_pair + gl_WorkGroupID.y, k = gl_GlobalInvocationID.x;
  LevelInfo info = levels[push.level];
  if (pairs[pair].enabled == 0u || k >= info.element_count) return;
  View view = view_of(pair);
  set_point(view, pair);
  vec4 a = TEXEL(template_a, view.template_base + int(k));
  vec2 top, bottom, f;
  vec3 p;
  bool visible;
  target_at(view, a, top, bottom, f, p, visible);
  vec2 left_right = mix(top, bottom, f.y);
  float f1 = mix(left_right.x, left_right.y, f.x);
  float r = f1 - (view.gain * a.w + view.bias);
  residuals[pair * push.weight_stride + k] = visible ? r : 3e38;
  if (!visible) return;
  uint at = gl_WorkGroupID.y * push.inputs_stride + uint(a.y) * info.width + uint(a.x);
  residual_f0[at] = vec2(abs(r), a.w);
  f1_prior[at] = vec2(f1, coarser_weight(pair, info, a.xy));
}
