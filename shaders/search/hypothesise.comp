#version 460
// Hypotheses: poses from three correspondences each, and their costs over all correspondences. Every other hypothesis draws
// from the most distinct quarter. Draws depend only on the number of the hypothesis, so that a pair has the same start in every
// batch.
// Groups: (hypotheses / local size, 1, pairs).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "shared.h"
#include "texels.glsl"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 1, std430) readonly buffer Pairs { PairInfo pairs[]; };
TEXELS(2, vec4, correspondences)
layout(set = 0, binding = 3, std430) writeonly buffer Hypotheses { vec4 hypotheses[]; };  // rows of (R, t); (cost, -, -, -)
layout(push_constant) uniform Push { MatchPush push; };
#include "se3.glsl"
#include "search/match_cost.glsl"
#include "search/match_pair.glsl"
#include "search/p3p.glsl"
#include "search/three_of.glsl"

vec3 ray_of(MatchView view, int k) {
  return normalize(vec3((pixel_of(view, k) - view.camera.zw) / view.camera.xy, 1.0));
}

void main() {
  uint pair = gl_WorkGroupID.z, number = gl_GlobalInvocationID.x;
  if (!takes_part(pair) || number >= push.hypotheses) return;
  MatchView view = match_view(pair, references[pairs[pair].reference]);
  Pose best = Pose(mat3(1.0), vec3(0.0));
  float least = 1e30;
  if (view.count >= 4) {
    int pool = number % 2u == 0u ? view.count : min(view.count, max(view.count / 4, 12));
    ivec3 drawn = three_of(uint(pool), number);
    vec3 x1 = point_of(view, drawn.x).xyz, x2 = point_of(view, drawn.y).xyz, x3 = point_of(view, drawn.z).xyz;
    vec3 y1 = ray_of(view, drawn.x), y2 = ray_of(view, drawn.y), y3 = ray_of(view, drawn.z);
    vec3 d12 = x1 - x2, d13 = x1 - x3, d23 = x2 - x3, distances[4];
    int solutions = p3p_distances(y1, y2, y3, dot(d12, d12), dot(d13, d13), dot(d23, d23), distances);
    float farther = 1.0 / (length(x1) + length(x2) + length(x3));
    for (int s = 0; s < solutions; ++s) {
      float ratio = farther * (distances[s].x + distances[s].y + distances[s].z);
      if (!(ratio < ICLK_MATCH_NEARER && ratio * ICLK_MATCH_NEARER > 1.0)) continue;
      Pose T = pose_of_triangles(x1, x2, x3, distances[s].x * y1, distances[s].y * y2, distances[s].z * y3);
      int inliers;
      float cost = match_cost(view, T, inliers);
      if (cost < least) {
        least = cost;
        best = T;
      }
    }
  }
  uint to = 4u * (pair * ICLK_MATCH_HYPOTHESES + number);
  hypotheses[to] = vec4(best.R[0][0], best.R[1][0], best.R[2][0], best.t.x);
  hypotheses[to + 1u] = vec4(best.R[0][1], best.R[1][1], best.R[2][1], best.t.y);
  hypotheses[to + 2u] = vec4(best.R[0][2], best.R[1][2], best.R[2][2], best.t.z);
  hypotheses[to + 3u] = vec4(least, 0.0, 0.0, 0.0);
}
