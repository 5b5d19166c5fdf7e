#version 460
// The pose of one round for each pair: refine_pose() of refine/pose.h in single precision, without its covariance. It is
// Levenberg-Marquardt over the reprojection errors of the aligned features with Cauchy's loss. The first solution uses the
// given sigma_0, also from the pose of refine_consensus.comp; the last one uses the errors that the residuals give.
// Inputs: features and aligned features. Outputs: states, and the tasks of the next round; no task for a pair whose pose does
// not change.
// Groups: (pairs, 1, 1).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "refine/observations.glsl"
layout(set = 0, binding = 7, std430) buffer Tasks { FeatureTask tasks[]; };
#include "refine/solve.glsl"
#include "refine/position_errors.glsl"
#include "refine/whiten.glsl"

// log(1 + x), x >= 0, without the rounding of 1 + x.
float log1p(float x) {
  if (x > 0.25) return log(1.0 + x);
  float y = x / (2.0 + x), y2 = y * y;
  return 2.0 * y * (1.0 + y2 * (1.0 / 3.0 + y2 * (1.0 / 5.0 + y2 * (1.0 / 7.0 + y2 / 9.0))));
}

// Sums into totals[]: the triangle of J^T w J, from 21 J^T w r, 27 the cost, which it returns.
float evaluate(Pose T, float scale) {
  float s[SUMS];
  clear(s);
  EACH_FEATURE(i) {
    if (observations[i].used == 0u) continue;
    FeatureInfo f = feature_at(i);
    Projection x = project(f, T);
    vec2 r;
    float square = square_of(i, x, r);
    if (!x.in_front) {
      s[27] = INFINITE;  // the step is undone
      continue;
    }
    float ratio = square / (scale * scale), w = 1.0 / (1.0 + ratio);
    vec3 W = W_of(i);
    vec2 white = whitened(W, r);
    Rows J = whitened(W, jacobian(x, f.inverse_depth, T));
    add_products(s, w, J.u, J.u);
    add_products(s, w, J.v, J.v);
    [[unroll]] for (int k = 0; k < 6; ++k) s[21 + k] += w * (J.u[k] * white.x + J.v[k] * white.y);
    s[27] += 0.5 * scale * scale * log1p(ratio);
  }
  sum(s);
  return s[27];
}

// Computes the damped step from the sums of the accepted pose, in columns[0..5]. Returns its size in px; below 0: there is no
// step.
float propose(float damping) {
  if (lane < 6u) columns[lane] = -matrix[21u + lane];
  factorise(damping, ICLK_LEAST_PIVOT);
  solve(1u);
  vec3 rho = vec3(columns[0], columns[1], columns[2]), phi = vec3(columns[3], columns[4], columns[5]);
  float size = max(abs(reference.fx), abs(reference.fy)) * (length(rho) + length(phi));
  return positive && is_finite(size) ? size : -1.0;
}

// Minimises from T in at most `iterations` steps; `status`: whether they converged. There is only one call to evaluate and one
// to solve, because inlining them once compiles fast.
Pose minimise(Pose T, float scale, uint iterations, out uint status, out float cost) {
  float damping = 1e-4, growth = 2.0, size = 0.0;
  Pose next = T;
  status = MAX_ITERATIONS;
  cost = INFINITE;
  [[dont_unroll]] for (uint n = 0u; n <= iterations; ++n) {
    float found = evaluate(next, scale), gain = cost - found;
    bool better = n == 0u ? is_finite(found) : found <= cost;
    if (n == 0u && !better) status = DIVERGED;
    if (better) {
      T = next;
      cost = found;
      keep_totals();
      if (n > 0u) damping = max(damping / 3.0, 1e-7);
      growth = 2.0;
    } else {
      damping *= growth;
      growth *= 2.0;
    }
    // A tiny step or no descent: the rest of the gradient is rounding.
    if (n > 0u && (size < 1e-4 || (better && gain <= 1e-7 * cost) || damping > 1e6)) status = CONVERGED;
    if (status != MAX_ITERATIONS || n == iterations) break;
    size = propose(damping);
    if (size < 0.0) {
      status = DIVERGED;
      break;
    }
    next = compose(T, se3_exp(vec3(columns[0], columns[1], columns[2]), vec3(columns[3], columns[4], columns[5])));
    next.R = orthonormalized(next.R);
  }
  return T;
}

// The standard deviation of points across their best line, from their sums and the sums of their products (uu, uv, vv).
float width_of(float count, vec2 sums, vec3 products) {
  vec2 mean = sums / count;
  vec3 C = products / count - vec3(mean.x * mean.x, mean.x * mean.y, mean.y * mean.y);
  float half_trace = 0.5 * (C.x + C.z), half_difference = 0.5 * (C.x - C.z);
  return sqrt(max(half_trace - length(vec2(half_difference, C.y)), 0.0));
}

const int DESCENT = 0, MEASURE = 1, OTHER = 2, LAST = 3;  // MEASURE: the cost of the descent's pose for OTHER

void main() {
  uint index = gl_WorkGroupID.x;
  begin(index);
  bool first_round = states[index].rounds == 0u;
  if (tasks[index].feature_count == 0u) return;
  Pose T = scaled(pose_of(tasks[index].pose), pair.unit), start = T;
  uint status = TOO_FEW_FEATURES;
  float used = observe(T), floor = push.sigma, depth = 0.0, cost = 0.0, inliers = 0.0;
  Pose other = pose_of(states[index].consensus);
  bool has_other = states[index].has_consensus != 0u;
  float first_cost = 0.0;
  [[dont_unroll]] for (int pass = DESCENT; pass <= LAST && used >= float(push.min_features); ++pass) {
    if (!has_other && (pass == MEASURE || pass == OTHER)) continue;
    if (pass == LAST && status != DIVERGED) {
      vec2 errors = position_errors(T);
      floor = errors.x;
      depth = errors.y;
    }
    if (pass == DESCENT || pass == LAST) whiten(T, floor, depth);
    float scale = pass == MEASURE || pass == OTHER ? ICLK_SHARP : push.cauchy_scale * floor;
    uint ending;
    Pose found = minimise(pass == OTHER ? other : T, scale, pass == MEASURE ? 0u : push.iterations, ending, cost);
    if (pass == MEASURE) first_cost = cost;
    bool wins = ending != DIVERGED && 2.0 * (first_cost - cost) > ICLK_CLEARLY_BETTER * ICLK_SHARP * ICLK_SHARP * used;
    if (pass == LAST || (pass == DESCENT && ending != DIVERGED) || (pass == OTHER && wins)) T = found;
    if (pass == LAST || pass == DESCENT || (pass == OTHER && wins)) status = ending;
  }

  // The inliers, the motion of the pose, and whether the same features are aligned as in the previous round.
  float s[SUMS];
  clear(s);
  float farthest = 0.0;
  EACH_FEATURE(i) {
    FeatureInfo f = feature_at(i);
    uint is_aligned = aligned[i].status == ALIGNED ? 1u : 0u;
    if (!first_round && observations[i].was_aligned != is_aligned) s[1] += 1.0;
    observations[i].was_aligned = is_aligned;
    if (!(f.inverse_depth > 0.0)) continue;
    PatchWarp a = warp_patch(f, reference, start), b = warp_patch(f, reference, T);
    farthest = max(farthest, a.valid && b.valid ? length(b.uv1 - a.uv1) : INFINITE);
    if (observations[i].used == 0u || !is_near(i, T, push.inlier_distance)) continue;
    vec2 uv = vec2(f.u - reference.cx, f.v - reference.cy);
    s[0] += 1.0;
    s[3] += uv.x;
    s[4] += uv.y;
    s[5] += uv.x * uv.x;
    s[6] += uv.x * uv.y;
    s[7] += uv.y * uv.y;
  }
  s[2] = farthest > push.round_tolerance ? 1.0 : 0.0;
  sum(s);
  inliers = s[0];
  if (status != TOO_FEW_FEATURES && status != DIVERGED &&
      (inliers < push.pose_inlier_share * used || inliers < float(push.min_features))) status = DIVERGED;
  if (status <= MAX_ITERATIONS &&
      !(width_of(inliers, vec2(s[3], s[4]), vec3(s[5], s[6], s[7])) >= ICLK_LEAST_WIDTH * float(push.height)))
    status = DEGENERATE;
  if (lane != 0u) return;
  states[index].pose = floats_of(T);
  states[index].floor = floor;
  states[index].depth_sigma = depth;
  states[index].cost = used > 0.0 ? cost / used : 0.0;
  states[index].used = uint(used);
  states[index].inliers = uint(inliers);
  states[index].status = status;
  states[index].rounds += 1u;
  // A pose with few inliers may still warp the patches better than the previous one; the next round or the verdict decides.
  bool moving = inliers >= float(push.min_features) && (s[2] > 0.0 || s[1] > 0.0);
  if (moving) tasks[index].pose = floats_of(scaled(T, 1.0 / pair.unit));
  else tasks[index].feature_count = 0u;
}
