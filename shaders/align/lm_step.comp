#version 460
// One Levenberg-Marquardt step from the parts of normal_equations.comp. push.iterations is the number of this
// iteration; iteration 0 begins the level. Groups: (pairs, 1, 1); 16 invocations: one for each of
// the 15 vectors of sums, then each solves.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "shared.h"
layout(local_size_x = 16) in;
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 2, std430) readonly buffer Pairs { PairInfo pairs[]; };
layout(set = 0, binding = 3, std430) readonly buffer Parts { vec4 parts[]; };
layout(set = 0, binding = 4, std430) buffer States { PairState states[]; };
layout(set = 0, binding = 5, std430) writeonly buffer Trace { TraceEntry trace[]; };
layout(push_constant) uniform Push { IteratePush push; };
vec4 sums[ICLK_SUM_VECTORS];
#include "se3.glsl"
#include "align/level.glsl"
#include "align/prior.glsl"
#include "align/belief.glsl"
#include "align/information.glsl"
#include "align/lm_step.glsl"
#include "align/lm_state.glsl"
shared vec4 total[ICLK_SUM_VECTORS];

void main() {
  uint pair = gl_WorkGroupID.x, lane = gl_LocalInvocationIndex;
  if (pairs[pair].enabled == 0u) return;
  bool starts = (push.flags & ICLK_FLAG_START) != 0u, ends = (push.flags & ICLK_FLAG_END) != 0u;
  Lm lm = load_state(pair);
  if ((push.flags & ICLK_FLAG_GIVEN) != 0u) {
    lm.pose = pose_of(pairs[pair].pose);
    lm.gain = pairs[pair].gain;
    lm.bias = pairs[pair].bias;
  }
  if (push.iterations == 0u && !ends) begin_level(lm);  // an earlier batch's state must not count as done
  bool skips = skips_level(pair) && !starts && !ends;
  lm.done = lm.done || skips;
  if (skips && lane == 0u && push.iterations == 0u) {
    store_state(pair, lm);
    leave_belief(pair, lm, false);
    states[pair].iterations[push.level] = 0u;
  }
  if (lm.done && !ends) return;  // the same for every lane
  if (lane < ICLK_SUM_VECTORS) {
    vec4 sum = vec4(0.0);
    for (uint i = 0u; i < push.groups; ++i) sum += parts[(pair * push.groups + i) * ICLK_SUM_VECTORS + lane];
    total[lane] = sum;
  }
  barrier();
  COPY_SUMS(sums, total)
  bool write = lane == 0u;
  bool believes = has_belief(pair);
  ReferenceInfo reference = references[pairs[pair].reference];
  LevelCamera camera = level_camera(reference, levels[push.level], push.level);
  float focal = max(abs(camera.fx), abs(camera.fy));
  if (starts)
    lm_start_photometric(lm);
  else if (ends)
    lm_end(lm, pair, believes);
  else
    lm_advance(lm, pair, push.iterations, believes, focal, reference.mean_inverse_depth, write);
  if (write) {
    store_state(pair, lm);
    if (!starts) leave_belief(pair, lm, believes);
    if (!starts && !ends) states[pair].iterations[push.level] = push.iterations + 1u;
  }
}
