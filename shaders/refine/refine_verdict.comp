#version 460
// The verdict on each pair after the last round, and the covariance of its pose: the decision of refine/refiner.cpp in single
// precision. Inputs: features, aligned features, states. Input and output: one RefinedInfo per pair, at first the result of
// ICLK. A separate buffer for that would be the ninth, but small GPUs bind only eight.
// Groups: (pairs, 1, 1).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "refine/observations.glsl"
layout(set = 0, binding = 7, std430) buffer Refined { RefinedInfo refined[]; };
#include "refine/solve.glsl"
#include "refine/medians.glsl"
#include "refine/whiten.glsl"
#include "refine/covariance.glsl"

shared float factor_of_variance;

// Whether the patch centre is inside image 1 by half the width of a patch.
bool is_visible(FeatureInfo f, Pose T) {
  PatchWarp w = warp_patch(f, reference, T);
  float margin = 0.5 * (ICLK_PATCH - 1);
  return f.inverse_depth > 0.0 && w.valid && w.uv1.x >= margin && w.uv1.y >= margin &&
         w.uv1.x <= float(push.width) - 1.0 - margin && w.uv1.y <= float(push.height) - 1.0 - margin;
}

// Writes the covariance to shared_part, in the unit of the pair: (J^T W J)^-1 times the variance under the M-estimator, plus
// the part of shared errors. Returns false if the features do not determine the pose.
bool covariance_at(Pose T, RefineState state, out float sigma) {
  float scale = push.cauchy_scale * state.floor;
  float s[SUMS];
  clear(s);
  EACH_FEATURE(i) {
    observations[i].value = -1.0;
    if (observations[i].used == 0u) continue;
    FeatureInfo f = feature_at(i);
    Projection x = project(f, T);
    vec2 r;
    float square = square_of(i, x, r), w = x.in_front ? 1.0 / (1.0 + square / (scale * scale)) : 0.0;
    observations[i].value = square;
    if (w == 0.0) continue;
    Rows J = whitened(W_of(i), jacobian(x, f.inverse_depth, T));
    add_products(s, w, J.u, J.u);
    add_products(s, w, J.v, J.v);
    s[21] += w * w * square;
    s[22] += w;
    s[23] += w * w;
  }
  sum(s);
  keep_totals();
  float n = float(state.used), freedom = max(2.0 * n - 6.0, 1.0), psi2 = s[21], weights = s[22];
  float huber = s[23] > 0.0 ? psi2 / freedom * (weights / n) / (s[23] * s[23] / (n * n)) : 0.0;
  float middle = median_of(state.used) / (2.0 * log(2.0)) * 2.0 * n / freedom;
  float variance = max(huber, is_finite(middle) ? middle : 0.0);
  sigma = sqrt(variance);
  factorise(0.0, ICLK_LEAST_PIVOT);
  if (!positive) return false;
  invert();
  shared_errors(T, scale, state.depth_sigma, psi2, weights, n);
  barrier();
  if (lane < 36u) shared_part[lane] += variance * columns[lane];
  return true;
}

// The numbers of (visible, candidates, aligned) features of this pair.
vec3 counts_at(Pose T) {
  float s[SUMS];
  clear(s);
  EACH_FEATURE(i) {
    uint found = aligned[i].status;
    if (found == ALIGNED) s[2] += 1.0;
    if (found == HIDDEN || !is_visible(feature_at(i), T)) continue;
    s[0] += 1.0;
    if (found != LOW_TEXTURE) s[1] += 1.0;
  }
  sum(s);
  return vec3(s[0], s[1], s[2]);
}

// Median motion of the features from pose a to pose b, px.
float correction(Pose a, Pose b) {
  float s[SUMS];
  clear(s);
  EACH_FEATURE(i) {
    FeatureInfo f = feature_at(i);
    observations[i].value = -1.0;
    if (!(f.inverse_depth > 0.0)) continue;
    PatchWarp wa = warp_patch(f, reference, a), wb = warp_patch(f, reference, b);
    observations[i].value = wa.valid && wb.valid ? length(wb.uv1 - wa.uv1) : INFINITE;
    s[0] += 1.0;
  }
  sum(s);
  return median_of(uint(s[0]));
}

// Whether the features found the pose of a learned model again.
bool found_again(RefineState state, uint iclk_status, vec3 counts, float sigma, float moved) {
  float inliers = float(state.inliers);
  return push.keep_unconfirmed != 0u && iclk_status <= MAX_ITERATIONS && pair.search != 0u && is_finite(moved) &&
         moved <= ICLK_REFUTED_CORRECTION && sigma <= ICLK_AGAIN_SIGMA && state.inliers >= push.min_inliers &&
         inliers >= ICLK_AGAIN_SHARE * counts.y && inliers >= ICLK_AGAIN_AGREEMENT * counts.z;
}

void main() {
  uint index = gl_WorkGroupID.x;
  begin(index);
  RefineState state = states[index];
  bool bent = turn != vec3(0.0);
  if (bent) {
    RefineState before = turns[index].before;
    bent = state.status <= MAX_ITERATIONS && state.inliers >= before.inliers;
    if (bent) {
      state.rounds = before.rounds;
    } else {
      state = before;
      turn = vec3(0.0);
      observe(pose_of(state.pose));
      whiten(pose_of(state.pose), state.floor, state.depth_sigma);
    }
    barrier();
  }
  uint iclk_status = refined[index].status, status = iclk_status, pose_status = state.status;
  bool is_refined = false, keeps = false;  // keeps: ICLK's pose is kept, which the features neither confirm nor refute
  vec3 counts = vec3(0.0);
  float sigma = 0.0, moved = 0.0;
  Pose T = pose_of(state.pose), iclk = scaled(pose_of(refined[index].pose), pair.unit);
  if (state.rounds > 0u) {
    counts = counts_at(T);
    if (state.used >= push.min_features) {  // there is a pose of the rounds
      bool determined = covariance_at(T, state, sigma);
      if (!determined && pose_status <= MAX_ITERATIONS) pose_status = DEGENERATE;
    }
    barrier();
    moved = correction(iclk, T);
    bool clear_agreement = float(state.inliers) >= ICLK_CLEAR_AGREEMENT * counts.z;
    float share = clear_agreement ? min(push.min_clear_share, push.min_inlier_share) : push.min_inlier_share;
    uint candidates = uint(counts.y), needed = max(push.min_inliers, uint(ceil(share * counts.y)));
    bool compatible = true;
    if (candidates < push.min_inliers && state.inliers < push.min_inliers) {
      status = TOO_FEW_FEATURES;
    } else if (state.inliers < needed && !found_again(state, iclk_status, counts, sigma, moved)) {
      status = DIVERGED;
      bool disagree = counts.z >= float(needed) && float(state.inliers) < ICLK_REFUTED_SHARE * counts.z;
      bool elsewhere = state.inliers >= push.min_inliers && (!is_finite(moved) || moved > ICLK_REFUTED_CORRECTION);
      compatible = pair.search == 0u || !(disagree || elsewhere);
    } else if (pose_status > MAX_ITERATIONS) {
      status = pose_status;
    } else if (!is_finite(moved) || moved > push.max_correction) {
      status = DIVERGED;
      compatible = false;
    } else {
      status = pose_status;
      is_refined = true;
    }
    keeps = !is_refined && push.keep_unconfirmed != 0u && compatible && iclk_status == CONVERGED;
    if (keeps) {
      status = iclk_status;
      barrier();
      depth_covariance(iclk, state.depth_sigma);
    }
  }
  memoryBarrierBuffer();
  barrier();  // all invocations have read ICLK's result
  if (lane < 36u) {
    float share = !is_refined ? 0.0 : bent ? turns[index].pose_share[lane] : turns[index].doubt[lane];
    float part = (shared_part[lane] + share) / ((lane / 6u < 3u ? pair.unit : 1.0) * (lane % 6u < 3u ? pair.unit : 1.0));
    bool own = keeps || state.rounds == 0u;
    refined[index].covariance[lane] =
        is_refined ? part : (own ? refined[index].covariance[lane] : 0.0) + (keeps ? part : 0.0);
  }
  if (lane < 12u) {
    float found = state.pose[lane] / (lane % 4u == 3u ? pair.unit : 1.0);
    bool kept = is_refined || (push.rivals != 0u && state.rounds > 0u);
    refined[index].pose[lane] = kept ? found : refined[index].pose[lane];
  }
  if (lane != 0u) return;
  refined[index].status = status;
  refined[index].refined = is_refined ? 1u : 0u;
  refined[index].rounds = state.rounds;
  refined[index].visible = uint(counts.x);
  refined[index].candidates = uint(counts.y);
  refined[index].aligned = uint(counts.z);
  refined[index].inliers = state.inliers;
  refined[index].sigma = sigma;
  refined[index].correction = moved;
  refined[index].pose_status = pose_status;
  refined[index].used = state.used;
  refined[index].standing = refined[index].seen = refined[index].rival_count = 0u;
  bool stated = is_refined && bent;
  refined[index].turn = float[3](stated ? turn.x : 0.0, stated ? turn.y : 0.0, stated ? turn.z : 0.0);
}
