#version 460
// A pose on which places agree becomes a rival; the places that it explains are left out for the next one. Groups: (pairs, 1,
// 1).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "refine/refine.h"
#include "se3.glsl"
layout(local_size_x = ICLK_REFINE_GROUP) in;
layout(set = 0, binding = 0, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 1, std430) buffer Questions { PairInfo questions[]; };
layout(set = 0, binding = 2, std430) buffer Correspondences { vec4 correspondences[]; };
layout(set = 0, binding = 3, std430) writeonly buffer Results { ResultInfo results[]; };
layout(push_constant) uniform Push { RivalPush push; };

shared uint keeps[ICLK_REFINE_GROUP];

void main() {
  uint pair = gl_WorkGroupID.x, lane = gl_LocalInvocationID.x, to = push.rival * push.pairs + pair;
  bool found = questions[pair].enabled != 0u && questions[pair].matched != 0u;
  Pose T = pose_of(questions[pair].pose);
  barrier();
  if (lane == 0u) {
    results[to].pose = questions[pair].pose;
    results[to].status = found ? 0u : 5u;  // converged, diverged
    questions[pair].enabled = found ? 1u : 0u;
    questions[pair].matched = 0u;
  }
  if (!found) return;
  ReferenceInfo r = references[questions[pair].reference];
  uint header = 2u * pair * (ICLK_ELSEWHERE_PLACES * push.features + 1u), count = uint(correspondences[header].x), kept = 0u;
  float reach = 2.0 * ICLK_MATCH_TOLERANCE * float(push.scale);
  for (uint first = 0u; first < count; first += ICLK_REFINE_GROUP) {  // in their order; overwrites the list
    uint from = header + 2u * (min(first + lane, count - 1u) + 1u);
    vec4 point = correspondences[from], pixel = correspondences[from + 1u];
    vec3 X = T.R * point.xyz + r.mean_inverse_depth * T.t;
    vec2 at = X.xy / X.z * vec2(r.fx, r.fy) + vec2(r.cx, r.cy);
    bool keep = first + lane < count && !(X.z > 0.0 && length(at - pixel.xy) < reach);
    keeps[lane] = keep ? 1u : 0u;
    barrier();
    uint before = 0u, all = 0u;
    for (uint i = 0u; i < ICLK_REFINE_GROUP; ++i) {
      before += i < lane ? keeps[i] : 0u;
      all += keeps[i];
    }
    uint slot = header + 2u * (kept + before + 1u);
    if (keep) {
      correspondences[slot] = point;
      correspondences[slot + 1u] = pixel;
    }
    kept += all;
    barrier();
  }
  if (lane == 0u) correspondences[header].x = float(kept);
}
