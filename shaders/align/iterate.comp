#version 460
// All iterations of one level of the device solver: residual -> normal equations -> Levenberg-Marquardt step, in one dispatch.
// One workgroup per pair. The pose stays in registers, and every lane solves the 6x6 system (8x8 with gain and bias). If a pair
// has too many elements for one workgroup, normal_equations.comp and lm_step.comp do the same in two dispatches per iteration.
// Groups: (pairs, 1, 1).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "shared.h"
#include "texels.glsl"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 2, std430) readonly buffer Pairs { PairInfo pairs[]; };
TEXELS(3, vec4, template_a)
TEXELS(4, vec4, template_b)
TEXELS(5, float, maps1)
layout(set = 0, binding = 6, std430) buffer Weights { vec4 weights[]; };
layout(set = 0, binding = 7, std430) buffer States { PairState states[]; };
layout(set = 0, binding = 8, std430) writeonly buffer Trace { TraceEntry trace[]; };
layout(push_constant) uniform Push { IteratePush push; };
#include "se3.glsl"
#include "align/level.glsl"
#include "align/residual.glsl"
#include "align/normal_equations.glsl"
#include "align/weights.glsl"
#include "align/pair.glsl"
#include "align/prior.glsl"
#include "align/belief.glsl"
#include "align/information.glsl"
#include "align/lm_step.glsl"
#include "align/lm_state.glsl"

void evaluate(View view, uint count) {
  clear_sums();
  add_elements(view, 0u, count);
  reduce_sums();
}

// Each lane writes the weights of its elements; no other lane reads them here.
float weigh_level(View view, uint count) {
  uint lane = gl_LocalInvocationIndex, lanes = gl_WorkGroupSize.x;
  uint vectors = (count + 4u * lanes - 1u) / (4u * lanes) * lanes;
  for (uint k = lane; k < vectors; k += lanes) {
    vec4 m = magnitudes_at(view, 4u * (k - lane) + lane, count);
    weights[view.weight_base + k] = m;
    count_below(m.x);
    count_below(m.y);
    count_below(m.z);
    count_below(m.w);
  }
  float scale = scale_of(view.weight_base, vectors);
  weigh(view.weight_base, vectors, scale);
  return scale;
}

void main() {
  uint pair = gl_WorkGroupID.x;
  if (pairs[pair].enabled == 0u) return;
  bool write = gl_LocalInvocationIndex == 0u;
  bool believes = has_belief(pair);
  ReferenceInfo reference = references[pairs[pair].reference];
  uint count = levels[push.level].element_count;
  View view = view_of(pair);
  Lm lm = load_state(pair);
  if ((push.flags & ICLK_FLAG_GIVEN) != 0u) {
    lm.pose = pose_of(pairs[pair].pose);
    lm.gain = pairs[pair].gain;
    lm.bias = pairs[pair].bias;
  }
  float focal = max(abs(view.camera.fx), abs(view.camera.fy));
  barrier();  // every lane has its state before lane 0 writes a new one

  bool starts = (push.flags & ICLK_FLAG_START) != 0u, ends = (push.flags & ICLK_FLAG_END) != 0u;
  uint taken = 0u;
  begin_level(lm);  // also at the first level: the state of an earlier batch must not count as done
  if (WEIGHTED && ROBUST != ICLK_ROBUST_UNIT && !view.unit_weights) {  // a learned M-estimator has written its weights
    view.pose = lm.pose;
    view.gain = lm.gain;
    view.bias = lm.bias;
    float scale = weigh_level(view, count);
    if (write) states[pair].scale[push.level] = scale;
  }
  uint iterations = skips_level(pair) ? 0u : push.iterations;
  uint evaluations = starts ? 1u : iterations + (ends ? 1u : 0u);
  for (uint i = 0u; i < evaluations; ++i) {
    bool last = ends && (lm.done || i == iterations);
    if (lm.done && !ends) break;
    view.pose = lm.pose;
    view.gain = lm.gain;
    view.bias = lm.bias;
    evaluate(view, count);
    if (starts) {
      lm_start_photometric(lm);
    } else if (last) {
      lm_end(lm, pair, believes);
      break;
    } else {
      lm_advance(lm, pair, i, believes, focal, reference.mean_inverse_depth, write);
      taken = i + 1u;
    }
  }
  if (write) {
    store_state(pair, lm);
    if (!starts) leave_belief(pair, lm, believes);
    if (!starts) states[pair].iterations[push.level] = taken;
  }
}
