#version 460
// Result of each pair of a recording, for shaders of the application: pose, gain, bias and a status from the last evaluation.
// Groups: (ceil(pairs / 64), 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x = 64) in;
layout(set = 0, binding = 0, std430) readonly buffer Pairs { PairInfo pairs[]; };
layout(set = 0, binding = 1, std430) readonly buffer States { PairState states[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Results { ResultInfo results[]; };
layout(push_constant) uniform Push { ResultPush push; };

// iclk::Status
const uint CONVERGED = 0u, MAX_ITERATIONS = 1u, LOW_OVERLAP = 2u, DEGENERATE = 3u, TOO_FEW_FEATURES = 4u, DIVERGED = 5u;

void main() {
  uint pair = gl_GlobalInvocationID.x;
  if (pair >= push.pairs) return;
  if (pairs[pair].enabled == 0u) {
    for (int i = 0; i < 12; ++i) results[pair].pose[i] = pairs[pair].pose[i];
    results[pair].gain = 1.0;
    results[pair].bias = 0.0;
    results[pair].cost = 0.0;
    results[pair].visible_fraction = 0.0;
    results[pair].correlation = 0.0;
    results[pair].last_step = 0.0;
    results[pair].status = TOO_FEW_FEATURES;
    return;
  }
  // Moments of f0 and of the warped f1 = r + a f0 + b, align/internal/normal_equations.cpp.
  float a = states[pair].accepted_gain, b = states[pair].accepted_bias;
  float n = states[pair].sums[4 * 11 + 3], s0 = states[pair].sums[4 * 10 + 3];
  float s00 = states[pair].sums[4 * 10 + 2], s0r = states[pair].sums[4 * 13 + 2], sr = states[pair].sums[4 * 13 + 3];
  float cost = states[pair].sums[4 * 14], visible = states[pair].sums[4 * 14 + 1], masked = states[pair].sums[4 * 14 + 2];
  float s1 = sr + a * s0 + b * n, s01 = s0r + a * s00 + b * s0;
  float s11 = cost + 2.0 * (a * s0r + b * sr) + a * a * s00 + 2.0 * a * b * s0 + b * b * n;
  float v0 = s00 - s0 * s0 / n, v1 = s11 - s1 * s1 / n;
  bool textured = n > 0.0 && v0 > 1e-6 * n && v1 > 1e-6 * n;
  float correlation = textured ? clamp((s01 - s0 * s1 / n) * inversesqrt(v0 * v1), -1.0, 1.0) : 0.0;
  float fraction = masked > 0.0 ? visible / masked : 0.0;
  float last_step = states[pair].last_step;

  uint status = CONVERGED;
  float sum = 0.0;
  for (int i = 0; i < 12; ++i) {
    results[pair].pose[i] = states[pair].accepted_pose[i];
    sum += abs(states[pair].accepted_pose[i]);
  }
  if (!(sum < 1e30) || !(cost < 1e30)) status = DIVERGED;
  else if (!(fraction >= push.min_visible) || visible == 0.0) status = LOW_OVERLAP;
  else if (states[pair].singular != 0u || !textured) status = DEGENERATE;
  else if (correlation < push.min_correlation) status = DIVERGED;
  else if (last_step > push.step_limit) status = MAX_ITERATIONS;
  results[pair].gain = a;
  results[pair].bias = b;
  results[pair].cost = n > 0.0 ? cost / n : 0.0;
  results[pair].visible_fraction = fraction;
  results[pair].correlation = correlation;
  results[pair].last_step = last_step;
  results[pair].status = status;
}
