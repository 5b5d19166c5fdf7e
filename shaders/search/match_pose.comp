#version 460
// The start of a pair by matching. The best hypothesis of each of ICLK_MATCH_GROUP shares is refined on all correspondences
// with Tukey's weights. The best of these is the start if enough correspondences agree with it. The pair then begins there, at
// a fine level, because with parallax coarse levels lead away from a good start (docs/explain/start-search.md). Otherwise the
// pair does not change.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "shared.h"
#include "texels.glsl"
#include "finite.glsl"
layout(local_size_x = ICLK_MATCH_GROUP) in;
layout(set = 0, binding = 0, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 1, std430) buffer Pairs { PairInfo pairs[]; };
TEXELS(2, vec4, correspondences)
layout(set = 0, binding = 3, std430) readonly buffer Hypotheses { vec4 hypotheses[]; };
layout(push_constant) uniform Push { MatchPush push; };
#include "se3.glsl"
#include "search/match_cost.glsl"
#include "search/match_pair.glsl"

shared float costs[ICLK_MATCH_GROUP];

Pose hypothesis(uint at) {
  vec4 a = hypotheses[at], b = hypotheses[at + 1u], c = hypotheses[at + 2u];
  return Pose(mat3(a.x, b.x, c.x, a.y, b.y, c.y, a.z, b.z, c.z), vec3(a.w, b.w, c.w));
}

// One Gauss-Newton step on all correspondences, T <- Exp(xi) T.
Pose refined(MatchView view, Pose T) {
  float H[36], g[6], L[36], xi[6], least = 1.0 / (4.0 * view.tolerance * view.tolerance);
  [[unroll]] for (int i = 0; i < 36; ++i) H[i] = 0.0;
  [[unroll]] for (int i = 0; i < 6; ++i) g[i] = 0.0;
  for (int k = 0; k < view.count; ++k) {
    vec3 X;
    vec2 r = match_residual(view, T, k, X);
    float keep = 1.0 - dot(r, r) * least;
    float w = keep > 0.0 ? keep * keep : 0.0, q = w > 0.0 ? 1.0 / X.z : 0.0, x = X.x * q, y = X.y * q;
    vec2 f = view.camera.xy;
    float a[6] = float[6](f.x * q, 0.0, -f.x * x * q, -f.x * x * y, f.x * (1.0 + x * x), -f.x * y);
    float b[6] = float[6](0.0, f.y * q, -f.y * y * q, -f.y * (1.0 + y * y), f.y * x * y, f.y * x);
    [[unroll]] for (int i = 0; i < 6; ++i) {
      g[i] += w * (a[i] * r.x + b[i] * r.y);
      [[unroll]] for (int j = 0; j < 6; ++j)
        if (j <= i) H[6 * i + j] += w * (a[i] * a[j] + b[i] * b[j]);
    }
  }
  bool ok = true;
  [[unroll]] for (int i = 0; i < 6; ++i)  // Cholesky; the diagonal has the inverses
    [[unroll]] for (int j = 0; j < 6; ++j) {
      if (j > i) continue;
      float s = H[6 * i + j] * (i == j ? 1.0 + 1e-5 : 1.0);
      [[unroll]] for (int k = 0; k < 6; ++k)
        if (k < j) s -= L[6 * i + k] * L[6 * j + k];
      if (i == j) ok = ok && s > 1e-6 * H[7 * i];
      L[6 * i + j] = i == j ? inversesqrt(max(s, 1e-30)) : s * L[7 * j];
    }
  [[unroll]] for (int i = 0; i < 6; ++i) {
    float s = g[i];
    [[unroll]] for (int k = 0; k < 6; ++k)
      if (k < i) s -= L[6 * i + k] * xi[k];
    xi[i] = s * L[7 * i];
  }
  [[unroll]] for (int i = 5; i >= 0; --i) {
    float s = xi[i];
    [[unroll]] for (int k = 0; k < 6; ++k)
      if (k > i) s -= L[6 * k + i] * xi[k];
    xi[i] = s * L[7 * i];
  }
  vec3 rho = vec3(xi[0], xi[1], xi[2]), phi = vec3(xi[3], xi[4], xi[5]);
  float size = dot(rho, rho) + dot(phi, phi);
  if (!ok || !is_finite(size) || size >= 1.0) return T;
  Pose moved = compose(se3_exp(rho, phi), T);
  moved.R = orthonormalized(moved.R);
  return moved;
}

void main() {
  uint pair = gl_WorkGroupID.z, lane = gl_LocalInvocationIndex;
  if (!takes_part(pair)) return;
  ReferenceInfo reference = references[pairs[pair].reference];
  MatchView view = match_view(pair, reference);
  uint first = pair * ICLK_MATCH_HYPOTHESES, chosen = lane;
  float least = 1e30;
  for (uint i = lane; i < push.hypotheses; i += ICLK_MATCH_GROUP) {
    float cost = hypotheses[4u * (first + i) + 3u].x;
    chosen = cost < least ? i : chosen;
    least = min(least, cost);
  }
  Pose T = hypothesis(4u * (first + chosen));
  for (int i = 0; i < ICLK_MATCH_STEPS; ++i) T = refined(view, T);
  int inliers;
  float cost = match_cost(view, T, inliers);
  bool believed = least < 1e30 && view.repeats < ICLK_MATCH_REPEATS &&
                  float(inliers) >= ICLK_MATCH_INLIERS + push.share * float(view.count);
  costs[lane] = believed ? cost : 1e30;
  barrier();
  bool mine = costs[lane] < 1e30, any = false;
  for (uint i = 0u; i < ICLK_MATCH_GROUP; ++i) {
    any = any || costs[i] < 1e30;
    mine = mine && (costs[lane] < costs[i] || (costs[lane] == costs[i] && lane <= i));
  }
  if (lane == 0u) {
    pairs[pair].matched = any ? 1u : 0u;
    pairs[pair].repeats = view.repeats;
  }
  float length = 1.0 / reference.mean_inverse_depth;
  if (mine) {
    pairs[pair].first_level = push.first_level;
    pairs[pair].pose = float[12](T.R[0][0], T.R[1][0], T.R[2][0], T.t.x * length, T.R[0][1], T.R[1][1], T.R[2][1],
                                 T.t.y * length, T.R[0][2], T.R[1][2], T.R[2][2], T.t.z * length);
  }
}
