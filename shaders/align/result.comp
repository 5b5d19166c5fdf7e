#version 460
// The verdict on each pair of the device solver (align/solver/verdict.cpp, in single precision), for shaders of the
// application: pose, covariance, gain, bias and status. Adds up the parts of agreement.comp.
// Groups: (ceil(pairs / 64), 1, 1).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "shared.h"
layout(local_size_x = 64) in;
layout(set = 0, binding = 0, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 1, std430) readonly buffer Pairs { PairInfo pairs[]; };
layout(set = 0, binding = 2, std430) readonly buffer Parts { vec4 parts[]; };
layout(set = 0, binding = 3, std430) buffer States { PairState states[]; };
layout(set = 0, binding = 4, std430) writeonly buffer Results { ResultInfo results[]; };
layout(push_constant) uniform Push { ResultPush push; };
#include "finite.glsl"
#include "se3.glsl"
#include "align/prior.glsl"
#include "align/information.glsl"
#include "align/moments.glsl"

// iclk::Status
const uint CONVERGED = 0u, MAX_ITERATIONS = 1u, LOW_OVERLAP = 2u, DEGENERATE = 3u, TOO_FEW_FEATURES = 4u, DIVERGED = 5u;

// Information about the pose, 6x6: with the prior, without the prior, the part that both images confirm, the cross term of both
// gradients, the mean of both images' own.
float H[36], image[36], confirmed[36], cross_term[36], both[36];
float L[36], inverse[36];  // Cholesky factor, and the inverse of `confirmed`

float agreement6(uint pair, uint matrix, uint i, uint j) {
  uint lo = min(i, j), hi = max(i, j);
  return states[pair].agreement[4u * ICLK_MATRIX_VECTORS * matrix + (hi < 4u ? 4u * lo + hi : 16u + 2u * lo + hi - 4u)];
}

void gather(uint pair, float variance) {
  float a = states[pair].accepted_gain;
  for (uint i = 0u; i < 6u; ++i)
    for (uint j = 0u; j < 6u; ++j) {
      uint at = 6u * i + j;
      float own, h = pose_information(pair, push.parameters > 6.0, i, j, own), shared_term = a * agreement6(pair, 0u, i, j);
      H[at] = image[at] = h;
      confirmed[at] = h - own + shared_term;
      cross_term[at] = shared_term;
      both[at] = 0.5 * (own + agreement6(pair, 1u, i, j));
    }
  if (pairs[pair].has_prior == 0u) return;
  Prior prior = prior_of(pose_of(pairs[pair].prior_pose), pairs[pair].prior_information,
                         pose_of(states[pair].accepted_pose));
  float scale = variance / (push.residual_sigma * push.residual_sigma);
  for (uint at = 0u; at < 36u; ++at) {
    float p = scale * prior.H[at];
    H[at] += p;
    confirmed[at] += p;
    cross_term[at] += p;
    both[at] += p;
  }
}

#define SCALE(M) for (uint at = 0u; at < 36u; ++at) M[at] *= d[at / 6u] * d[at % 6u];

// Whether M - shift I is positive definite; L = its Cholesky factor.
#define CHOLESKY(M, shift, ok)                                              \
  for (uint i = 0u; i < 6u; ++i)                                            \
    for (uint j = 0u; j <= i; ++j) {                                        \
      float s = M[6u * i + j] - (i == j ? shift : 0.0);                     \
      for (uint k = 0u; k < j; ++k) s -= L[6u * i + k] * L[6u * j + k];     \
      ok = ok && (i != j || s > 0.0);                                       \
      L[6u * i + j] = i == j ? sqrt(max(s, 1e-30)) : s / L[7u * j];         \
    }

// Column j of (L L^T)^-1.
void inverse_column(uint j, out float x[6]) {
  for (uint i = 0u; i < 6u; ++i) {
    float s = i == j ? 1.0 : 0.0;
    for (uint k = 0u; k < i; ++k) s -= L[6u * i + k] * x[k];
    x[i] = s / L[7u * i];
  }
  for (uint n = 0u; n < 6u; ++n) {
    uint i = 5u - n;
    float s = x[i];
    for (uint k = i + 1u; k < 6u; ++k) s -= L[6u * k + i] * x[k];
    x[i] = s / L[7u * i];
  }
}

// Agreement::variance_ratio
float variance_ratio(uint pair) {
  float patch_scores = states[pair].agreement[4 * ICLK_SCORES], pixel_scores = states[pair].agreement[4 * ICLK_SCORES + 1];
  float numbers = 2.0 * states[pair].agreement[4 * ICLK_SCORES + 2];
  if (!(pixel_scores > 0.0)) return 1.0;
  return max(1.0, patch_scores / pixel_scores * numbers / max(numbers - push.parameters, 1.0));
}

// both = variance inverse H inverse, units restored.
void spread(float variance, float d[6]) {
  for (uint i = 0u; i < 6u; ++i)
    for (uint j = 0u; j < 6u; ++j) {
      float s = 0.0;
      for (uint k = 0u; k < 6u; ++k) {
        float t = 0.0;
        for (uint l = 0u; l < 6u; ++l) t += H[6u * k + l] * inverse[6u * l + j];
        s += inverse[6u * i + k] * t;
      }
      both[6u * i + j] = variance * d[i] * d[j] * s;
    }
}

// The part of the verdict that depends on eigenvalues. Afterwards `both` is the covariance.
uint judge(uint pair, float variance, float correlation) {
  gather(pair, variance);
  float d[6];
  bool ok = states[pair].singular == 0u;
  for (uint i = 0u; i < 6u; ++i) {
    ok = ok && H[7u * i] > 0.0;
    d[i] = ok ? inversesqrt(H[7u * i]) : 1.0;
  }
  if (!ok) return DEGENERATE;
  SCALE(H)
  CHOLESKY(H, ICLK_LEAST_EIGENVALUE, ok)
  if (!ok) return DEGENERATE;
  if (!is_finite(correlation) || correlation < push.min_correlation) return DIVERGED;

  SCALE(confirmed)
  SCALE(cross_term)
  SCALE(both)
  float cross_trace = 0.0, both_trace = 0.0;
  for (uint i = 0u; i < 6u; ++i) {
    cross_trace += cross_term[7u * i];
    both_trace += both[7u * i];
  }
  if (!is_finite(cross_trace) || cross_trace < push.min_agreement * both_trace) return DIVERGED;
  // The least ratio x^T cross x / x^T both x exceeds the limit where cross - limit both is positive definite.
  for (uint at = 0u; at < 36u; ++at) cross_term[at] -= push.min_agreement * both[at];
  CHOLESKY(cross_term, 0.0, ok)
  CHOLESKY(both, 0.0, ok)
  CHOLESKY(confirmed, 0.0, ok)
  if (!ok) return DEGENERATE;
  for (uint j = 0u; j < 6u; ++j) {
    float x[6];
    inverse_column(j, x);
    for (uint i = 0u; i < 6u; ++i) inverse[6u * i + j] = x[i];
  }
  spread(variance, d);
  ReferenceInfo reference = references[pairs[pair].reference];
  float focal = max(abs(reference.fx), abs(reference.fy));
  float turn = sqrt(both[21] + both[28] + both[35]), shift = sqrt(both[0] + both[7] + both[14]);
  float sigma = focal * (turn + reference.mean_inverse_depth * shift);
  float more = variance_ratio(pair) - 1.0;  // for the part of H from the images, not from the prior
  for (uint at = 0u; at < 36u; ++at) H[at] += more * image[at] * d[at / 6u] * d[at % 6u];
  spread(variance, d);
  bool one_pose = pairs[pair].has_prior != 0u || !(pairs[pair].repeats >= ICLK_MATCH_REPEATS);
  return one_pose && sigma <= ICLK_LARGEST_SIGMA * max(1.0, focal / 500.0) ? CONVERGED : DEGENERATE;
}

void main() {
  uint pair = gl_GlobalInvocationID.x;
  if (pair >= push.pairs) return;
  for (uint i = 0u; i < 36u; ++i) results[pair].covariance[i] = 0.0;
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
  vec4 total[2 * ICLK_MATRIX_VECTORS];
  [[unroll]] for (uint i = 0u; i < uint(ICLK_SUM_VECTORS); ++i) total[i] = vec4(0.0);
  for (uint g = 0u; g < push.groups; ++g)  // the outer loop: lavapipe counts the iterations of nested loops together
    [[unroll]] for (uint i = 0u; i < uint(ICLK_SUM_VECTORS); ++i)
      total[i] += parts[(pair * push.groups + g) * ICLK_SUM_VECTORS + i];
  [[unroll]] for (uint i = 0u; i < uint(ICLK_SUM_VECTORS); ++i) {
    states[pair].agreement[4u * i] = total[i].x;
    states[pair].agreement[4u * i + 1u] = total[i].y;
    states[pair].agreement[4u * i + 2u] = total[i].z;
    states[pair].agreement[4u * i + 3u] = total[i].w;
  }
  states[pair].repeats = pairs[pair].repeats;
  float a = states[pair].accepted_gain, b = states[pair].accepted_bias, n = states[pair].sums[4 * 11 + 3];
  float cost = states[pair].sums[4 * 14], visible = states[pair].sums[4 * 14 + 1], masked = states[pair].sums[4 * 14 + 2];
  float correlation = correlation_of(pair);
  float fraction = masked > 0.0 ? visible / masked : 0.0;
  float last_step = states[pair].last_step;

  float sum = 0.0;
  for (int i = 0; i < 12; ++i) {
    results[pair].pose[i] = states[pair].accepted_pose[i];
    sum += abs(states[pair].accepted_pose[i]);
  }
  for (int i = 0; i < ICLK_SUM_FLOATS; ++i) sum += abs(states[pair].sums[i]);
  float variance = max(cost / max(visible - push.parameters, 1.0), ICLK_LEAST_SIGMA * ICLK_LEAST_SIGMA);
  uint status;
  if (!is_finite(sum) || sum >= 1e30) status = DIVERGED;
  else if (!(fraction >= push.min_visible) || visible == 0.0) status = LOW_OVERLAP;
  else if (correlation == 0.0) status = DEGENERATE;  // an image is constant
  else status = judge(pair, variance, correlation);
  if (status == CONVERGED) {
    for (uint i = 0u; i < 36u; ++i) results[pair].covariance[i] = both[i];
    if (last_step > push.step_limit) status = MAX_ITERATIONS;
  }
  results[pair].gain = a;
  results[pair].bias = b;
  results[pair].cost = n > 0.0 ? cost / n : 0.0;
  results[pair].visible_fraction = fraction;
  results[pair].correlation = correlation;
  results[pair].last_step = last_step;
  results[pair].status = status;
}
