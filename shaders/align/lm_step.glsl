// The Levenberg-Marquardt step of align/solver/lm.h in single precision. Needs belief.glsl, sums[] and the bindings
// pairs[], states[] and trace[].
#include "finite.glsl"
layout(constant_id = 1) const bool PHOTOMETRIC = true;
layout(constant_id = 2) const bool ADAPTIVE = false;

// The state of a pair between steps, in registers while a shader iterates. `accepted` points keep the sums of the last accepted
// evaluation, from which a rejected step is tried again.
struct Lm {
  Pose pose;
  float gain, bias;
  Pose accepted_pose;
  float accepted_gain, accepted_bias;
  float objective, predicted, lambda, nu, last_step;
  float scale;  // of beliefs: belief_scale()
  bool has_accepted, done, singular;
};

vec4 accepted_sums[ICLK_SUM_VECTORS];

#define COPY_SUMS(to, from)                                                                                        \
  to[0] = from[0]; to[1] = from[1]; to[2] = from[2]; to[3] = from[3]; to[4] = from[4]; to[5] = from[5];            \
  to[6] = from[6]; to[7] = from[7]; to[8] = from[8]; to[9] = from[9]; to[10] = from[10]; to[11] = from[11];        \
  to[12] = from[12]; to[13] = from[13]; to[14] = from[14];

// Gain and bias from the moments of both images, sums taken at gain 1 and bias 0.
void lm_start_photometric(inout Lm lm) {
  float n = sums[11].w, s0 = sums[10].w, s00 = sums[10].z;
  float s1 = sums[13].w + s0, s11 = sums[14].x + 2.0 * sums[13].z + s00;
  float v0 = s00 - s0 * s0 / n, v1 = s11 - s1 * s1 / n;
  if (!is_finite(v0 + v1) || !(n > 0.0) || !(v0 > 1e-6 * n) || !(v1 > 0.0)) return;
  lm.gain = clamp(sqrt(v1 / v0), ICLK_GAIN_MIN, ICLK_GAIN_MAX);
  lm.bias = (s1 - lm.gain * s0) / n;
}

// Judges the evaluation in `sums`, taken at lm.pose. Returns whether it was accepted.
bool lm_judge(inout Lm lm, uint pair, bool believes) {
  float distance = 0.0;
  if (ADAPTIVE && believes) distance = belief_at(pair, lm.pose).objective;
  if (ADAPTIVE && lm.has_accepted) {
    float share = sums[11].w > 0.0 ? accepted_sums[11].w / sums[11].w : 1e30;
    float compared = sums[14].x * share + lm.scale * distance;
    float ratio = lm.predicted > 0.0 ? (lm.objective - compared) / lm.predicted : 0.0;
    if (!is_finite(ratio) || ratio <= ICLK_LM_ACCEPT) {
      lm.lambda = max(lm.lambda * lm.nu, ICLK_LM_REJECTED);
      lm.nu *= 2.0;
      lm.pose = lm.accepted_pose;
      lm.gain = lm.accepted_gain;
      lm.bias = lm.accepted_bias;
      return false;
    }
    float x = 2.0 * ratio - 1.0;
    lm.lambda = max(lm.lambda * max(1.0 / 3.0, 1.0 - x * x * x), ICLK_LM_LEAST);
    lm.nu = 2.0;
  }
  lm.accepted_pose = lm.pose;
  lm.accepted_gain = lm.gain;
  lm.accepted_bias = lm.bias;
  COPY_SUMS(accepted_sums, sums)
  lm.scale = belief_scale(sums[14].x, sums[11].w);
  lm.objective = sums[14].x + lm.scale * distance;
  lm.has_accepted = true;
  return true;
}

// The next step from the accepted point: (H + lambda D) xi = g by a Cholesky factorisation of the system scaled to a unit
// diagonal, T_10 <- T_10 Exp(xi)^-1.
void lm_propose(inout Lm lm, uint pair, bool believes, float focal, float mean_inverse_depth, float step_tolerance) {
  float A[64], g[8], d[8];
#define ROW(i, lo, hi)                                                                              \
  A[8 * i] = lo.x; A[8 * i + 1] = lo.y; A[8 * i + 2] = lo.z; A[8 * i + 3] = lo.w;                   \
  A[8 * i + 4] = hi.x; A[8 * i + 5] = hi.y; A[8 * i + 6] = hi.z; A[8 * i + 7] = hi.w;
  ROW(0, accepted_sums[0], accepted_sums[4])
  ROW(1, accepted_sums[1], accepted_sums[5])
  ROW(2, accepted_sums[2], accepted_sums[6])
  ROW(3, accepted_sums[3], accepted_sums[7])
  ROW(4, vec4(accepted_sums[4].x, accepted_sums[5].x, accepted_sums[6].x, accepted_sums[7].x), accepted_sums[8])
  ROW(5, vec4(accepted_sums[4].y, accepted_sums[5].y, accepted_sums[6].y, accepted_sums[7].y), accepted_sums[9])
  ROW(6, vec4(accepted_sums[4].z, accepted_sums[5].z, accepted_sums[6].z, accepted_sums[7].z), accepted_sums[10])
  ROW(7, vec4(accepted_sums[4].w, accepted_sums[5].w, accepted_sums[6].w, accepted_sums[7].w), accepted_sums[11])
  g[0] = accepted_sums[12].x; g[1] = accepted_sums[12].y; g[2] = accepted_sums[12].z; g[3] = accepted_sums[12].w;
  g[4] = accepted_sums[13].x; g[5] = accepted_sums[13].y; g[6] = accepted_sums[13].z; g[7] = accepted_sums[13].w;
  // The pose moves gain * f0, so its columns are multiplied by the gain.
  float a = lm.accepted_gain;
  [[unroll]] for (int i = 0; i < 6; ++i) {
    g[i] *= a;
    [[unroll]] for (int j = 0; j < 6; ++j) A[8 * i + j] *= a * a;
    A[8 * i + 6] *= a; A[8 * i + 7] *= a; A[48 + i] *= a; A[56 + i] *= a;
  }
  if (!PHOTOMETRIC) {
    [[unroll]] for (int i = 0; i < 8; ++i) {
      A[8 * i + 6] = 0.0; A[8 * i + 7] = 0.0; A[48 + i] = 0.0; A[56 + i] = 0.0;
    }
    A[54] = 1.0; A[63] = 1.0; g[6] = 0.0; g[7] = 0.0;
  }
  if (believes) {
    Prior p = belief_at(pair, lm.accepted_pose);
    [[unroll]] for (int i = 0; i < 6; ++i) {
      g[i] += lm.scale * p.g[i];
      [[unroll]] for (int j = 0; j < 6; ++j) A[8 * i + j] += lm.scale * p.H[6 * i + j];
    }
  }

  bool ok = true;
  [[unroll]] for (int i = 0; i < 8; ++i) {
    ok = ok && A[9 * i] > 0.0;
    d[i] = ok ? inversesqrt(A[9 * i]) : 1.0;
  }
  float L[64], y[8], xi[8];
  [[unroll]] for (int i = 0; i < 8; ++i) {
    [[unroll]] for (int j = 0; j < 8; ++j) {
      if (j < i) {
        float s = A[8 * i + j] * d[i] * d[j];
        [[unroll]] for (int k = 0; k < 8; ++k)
          if (k < j) s -= L[8 * i + k] * L[8 * j + k];
        L[8 * i + j] = s * L[9 * j];  // the diagonal has the inverses
      }
    }
    float p = 1.0 + lm.lambda;
    [[unroll]] for (int k = 0; k < 8; ++k)
      if (k < i) p -= L[8 * i + k] * L[8 * i + k];
    ok = ok && p > ICLK_LEAST_PIVOT;
    L[9 * i] = inversesqrt(max(p, ICLK_LEAST_PIVOT));
  }
  [[unroll]] for (int i = 0; i < 8; ++i) {
    float s = g[i] * d[i];
    [[unroll]] for (int k = 0; k < 8; ++k)
      if (k < i) s -= L[8 * i + k] * y[k];
    y[i] = s * L[9 * i];
  }
  [[unroll]] for (int i = 7; i >= 0; --i) {
    float s = y[i];
    [[unroll]] for (int k = 0; k < 8; ++k)
      if (k > i) s -= L[8 * k + i] * xi[k];
    xi[i] = s * L[9 * i];
  }
  float predicted = 0.0, size = 0.0;
  [[unroll]] for (int i = 0; i < 8; ++i) {
    xi[i] *= d[i];
    predicted += xi[i] * (g[i] + lm.lambda * A[9 * i] * xi[i]);
    size += abs(xi[i]);
  }
  if (!ok || !is_finite(size) || size >= 1e30) {
    lm.singular = true;
    lm.done = true;
    lm.last_step = 0.0;
    return;
  }
  vec3 rho = vec3(xi[0], xi[1], xi[2]), phi = vec3(xi[3], xi[4], xi[5]);
  lm.predicted = predicted;
  lm.pose = compose(lm.accepted_pose, se3_exp(-rho, -phi));
  lm.pose.R = orthonormalized(lm.pose.R);
  if (PHOTOMETRIC) {
    lm.gain = clamp(lm.accepted_gain + xi[6], ICLK_GAIN_MIN, ICLK_GAIN_MAX);
    lm.bias = lm.accepted_bias + xi[7];
  }
  lm.last_step = focal * (length(phi) + length(rho) * mean_inverse_depth);
  lm.done = lm.last_step < step_tolerance;
}
