#version 460
// After the last round: the turn of the target while its rows were read, pair_turn() of refine/internal/turn.h in single
// precision. A pair with a proven turn gets another pose, from the positions of unrolled(). The verdict takes it if it loses no
// inlier.
// Inputs: features, aligned features, states. Outputs: turns, and the tasks of that pose; no task for a pair without a turn.
// Groups: (pairs, 1, 1).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#define ICLK_FINDS_TURNS
#include "refine/observations.glsl"
layout(set = 0, binding = 7, std430) buffer Tasks { FeatureTask tasks[]; };
#include "refine/solve.glsl"
#include "refine/medians.glsl"

// A feature at the time of its row, its residual, and du1 / d(pose, turn).
struct Sighting {
  bool in_front;
  vec2 r;
  Rows pose;
  vec3 turn_u, turn_v;
};

Sighting sighting(uint i, Pose T, vec3 turned) {
  FeatureInfo f = feature_at(i);
  float at = row_time(aligned[i].v);
  mat3 R = turned_by(-turned * at);
  Pose rolled = Pose(R * T.R, R * T.t);
  Projection x = project(f, rolled);
  Sighting s;
  s.in_front = x.in_front;
  s.r = vec2(aligned[i].u, aligned[i].v) - x.uv1;
  s.pose = jacobian(x, f.inverse_depth, rolled);
  s.turn_u = at * cross(x.du, x.p);
  s.turn_v = at * cross(x.dv, x.p);
  return s;
}

// The scatter of a component in px, by the median of the `count` used features.
float scatter(Pose T, vec3 turned, uint count) {
  EACH_FEATURE(i) {
    observations[i].value = -1.0;
    if (observations[i].used == 0u) continue;
    Sighting s = sighting(i, T, turned);
    observations[i].value = s.in_front ? length(s.r) : INFINITE;
  }
  return median_of(count) / sqrt(2.0 * log(2.0));
}

// One Gauss-Newton step of pose and turn; the pose is eliminated. A is its block of the normal equations, B the coupling block;
// `columns` become A^-1 B. S: the information about the turn. Returns false if the features do not determine the pose.
bool step_turn(inout Pose T, inout vec3 turned, float sigma, out mat3 S) {
  float s[SUMS], squared = 1.0 / (sigma * sigma);
  clear(s);
  EACH_FEATURE(i) {
    if (observations[i].used == 0u) continue;
    Sighting x = sighting(i, T, turned);
    if (!x.in_front) continue;
    float w = squared / (1.0 + dot(x.r, x.r) * squared / (ICLK_TURN_CAUCHY * ICLK_TURN_CAUCHY));
    add_products(s, w, x.pose.u, x.pose.u);
    add_products(s, w, x.pose.v, x.pose.v);
    [[unroll]] for (int k = 0; k < 6; ++k) s[21 + k] += w * (x.pose.u[k] * x.r.x + x.pose.v[k] * x.r.y);
  }
  sum(s);
  keep_totals();
  clear(s);
  EACH_FEATURE(i) {
    if (observations[i].used == 0u) continue;
    Sighting x = sighting(i, T, turned);
    if (!x.in_front) continue;
    float w = squared / (1.0 + dot(x.r, x.r) * squared / (ICLK_TURN_CAUCHY * ICLK_TURN_CAUCHY));
    [[unroll]] for (int c = 0; c < 3; ++c) {
      [[unroll]] for (int k = 0; k < 6; ++k)
        s[6 * c + k] += w * (x.pose.u[k] * x.turn_u[c] + x.pose.v[k] * x.turn_v[c]);
      [[unroll]] for (int d = 0; d < 3; ++d)
        if (d >= c) s[18 + c + d + (c > 0 ? 1 : 0)] += w * (x.turn_u[c] * x.turn_u[d] + x.turn_v[c] * x.turn_v[d]);
      s[24 + c] += w * (x.turn_u[c] * x.r.x + x.turn_v[c] * x.r.y);
    }
  }
  sum(s);
  factorise(0.0, ICLK_LEAST_PIVOT);
  if (lane < 18u) columns[lane] = totals[lane];
  else if (lane < 24u) columns[lane] = matrix[lane + 3u];
  barrier();
  solve(4u);
  float prior = 1.0 / (ICLK_TURN_PRIOR_SIGMA * ICLK_TURN_PRIOR_SIGMA);
  S = mat3(totals[18], totals[19], totals[20], totals[19], totals[21], totals[22], totals[20], totals[22], totals[23]);
  vec3 b = vec3(totals[24], totals[25], totals[26]) - prior * turned;
  [[dont_unroll]] for (int c = 0; c < 3; ++c) {
    [[dont_unroll]] for (int k = 0; k < 6; ++k) {
      S[0][c] -= totals[6 * c + k] * columns[k];
      S[1][c] -= totals[6 * c + k] * columns[6 + k];
      S[2][c] -= totals[6 * c + k] * columns[12 + k];
      b[c] -= totals[6 * c + k] * columns[18 + k];
    }
    S[c][c] += prior;
  }
  vec3 by_turn = inverse(S) * b;
  float xi[6];
  [[unroll]] for (int k = 0; k < 6; ++k)
    xi[k] = columns[18 + k] - dot(vec3(columns[k], columns[6 + k], columns[12 + k]), by_turn);
  T = compose(T, se3_exp(vec3(xi[0], xi[1], xi[2]), vec3(xi[3], xi[4], xi[5])));
  T.R = orthonormalized(T.R);
  turned += by_turn;
  return positive && is_finite(dot(by_turn, by_turn) + xi[0] + xi[1] + xi[2] + xi[3] + xi[4] + xi[5]);
}

void main() {
  uint index = gl_WorkGroupID.x;
  begin(index);
  RefineState before = states[index];
  if (lane == 0u) tasks[index].feature_count = 0u;
  if (before.rounds == 0u || before.used < uint(ICLK_TURN_SIGHTINGS)) return;
  Pose T = pose_of(before.pose);
  vec3 turned = vec3(0.0);
  mat3 S = mat3(1.0);
  float sigma = ICLK_TURN_FIRST_SIGMA;
  [[dont_unroll]] for (int n = 0; n < ICLK_TURN_SCALES * ICLK_TURN_ITERATIONS; ++n) {
    if (n % ICLK_TURN_ITERATIONS == 0) {
      if (n > 0) sigma = max(ICLK_TURN_LEAST_SIGMA, scatter(T, turned, before.used));
      turned = vec3(0.0);
    }
    if (!step_turn(T, turned, sigma, S)) return;
  }
  // The motion of a typical pixel of the first or last row by the turn.
  float radius = 0.25 * float(max(push.width, push.height));
  float bend = 0.5 * length(turned * vec3(reference.fy, reference.fx, radius));
  float chi2 = dot(turned, S * turned);
  mat3 C = inverse(S);
  float odds = 0.5 * chi2 - 0.5 * log(determinant(S)) - 3.0 * log(ICLK_TURN_EXPECTED);
  float probability = 1.0 / (1.0 + exp(-odds));
  // The twist from the pose without the turn to the one with it: the logarithm to first order, because they differ by pixels
  // only.
  Pose straight = pose_of(before.pose);
  mat3 R = transpose(straight.R) * T.R;
  vec3 rho = transpose(straight.R) * (T.t - straight.t);
  vec3 phi = 0.5 * vec3(R[1][2] - R[2][1], R[2][0] - R[0][2], R[0][1] - R[1][0]);
  float way[6] = float[6](rho.x, rho.y, rho.z, phi.x, phi.y, phi.z);
  if (lane < 36u) {
    uint i = lane / 6u, j = lane % 6u;
    float share = dot(vec3(columns[i], columns[6u + i], columns[12u + i]),
                      C * vec3(columns[j], columns[6u + j], columns[12u + j]));
    float doubt = probability * (way[i] * way[j] + share);
    turns[index].pose_share[lane] = share;
    turns[index].doubt[lane] = is_finite(doubt) ? doubt : 0.0;
  }
  if (lane != 0u || !(chi2 > ICLK_TURN_PROVEN_CHI2) || !(bend > ICLK_TURN_PROVEN_BEND)) return;
  turns[index].turn = float[3](turned.x, turned.y, turned.z);
  turns[index].before = before;
  tasks[index].feature_count = pair.feature_count;
  tasks[index].pose = floats_of(scaled(T, 1.0 / pair.unit));
}
