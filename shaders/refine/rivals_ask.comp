#version 460
// Selects the answers for which rivals are searched for, and the features to search for: their places, their warps by the
// answer, and their points. Groups: (pairs, 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "refine/refine.h"
#include "se3.glsl"
#include "refine/warp.glsl"
layout(local_size_x = ICLK_REFINE_GROUP) in;
layout(set = 0, binding = 0, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 1, std430) readonly buffer Pairs { RefinePair pairs[]; };
layout(set = 0, binding = 2, std430) readonly buffer FeatureList { FeatureInfo features[]; };
layout(set = 0, binding = 3, std430) readonly buffer Aligned { AlignedInfo aligned[]; };
layout(set = 0, binding = 4, std430) readonly buffer Refined { RefinedInfo refined[]; };
layout(set = 0, binding = 5, std430) writeonly buffer Questions { PairInfo questions[]; };
layout(set = 0, binding = 6, std430) writeonly buffer Sought { vec4 sought[]; };
layout(push_constant) uniform Push { RivalPush push; };
#include "refine/rivals.glsl"
#include "search/match_features.glsl"

shared uint standing;

vec2 to_map(vec2 uv) { return (uv + 0.5) / float(push.scale) - 0.5; }

void main() {
  uint index = gl_WorkGroupID.x, lane = gl_LocalInvocationID.x;
  RefinePair pair = pairs[index];
  ReferenceInfo reference = references[pair.reference];
  bool asked = pair.asks != 0u && refined[index].status == CONVERGED, is_refined = refined[index].refined != 0u;
  Pose T = pose_of(refined[index].pose);
  if (lane == 0u) standing = 0u;
  barrier();
  // search: the number of features to search for, few if the answer explains nearly all. gain: the share that it explains,
  // without those that stand still. bias: the number that is seen elsewhere.
  uint still = 0u;
  for (uint i = pair.first_feature + lane; i < pair.first_feature + pair.feature_count; i += ICLK_REFINE_GROUP)
    still += stands_still(aligned[i], features[i], reference, T, is_refined) ? 1u : 0u;
  atomicAdd(standing, still);
  barrier();
  float candidates = max(float(refined[index].candidates), 1.0);
  float explained = is_refined ? (float(refined[index].inliers) - float(standing)) / candidates : 0.0;
  uint all = min(pair.feature_count, push.features);
  uint count = explained < ICLK_ELSEWHERE_EXPLAINED ? all : min(all, ICLK_ELSEWHERE_SAMPLE);
  for (uint match = lane; match < count; match += ICLK_REFINE_GROUP) {
    uint i = pair.first_feature + feature_of(match * all / count, pair.feature_count);
    FeatureInfo f = features[i];
    PatchWarp w = warp_patch(f, reference, T);
    bool valid = f.inverse_depth > 0.0 && w.valid, agree = is_refined && agrees(aligned[i], f, reference, T);
    float depth = valid ? reference.mean_inverse_depth / f.inverse_depth : 0.0;
    vec3 ray = vec3((f.u - reference.cx) / reference.fx, (f.v - reference.cy) / reference.fy, 1.0);
    uint to = (index * push.features + match) * ICLK_ELSEWHERE_STRIDE;
    sought[to] = vec4(to_map(w.uv1), agree ? 1.0 : 0.0, valid ? 1.0 : 0.0);
    sought[to + 1u] = vec4(w.A_inverse[0], w.A_inverse[1]);
    sought[to + 2u] = vec4(to_map(vec2(f.u, f.v)), 0.0, 0.0);
    sought[to + 3u] = vec4(ray * depth, 0.0);
  }
  if (lane != 0u) return;
  questions[index].reference = pair.reference;
  questions[index].enabled = asked ? 1u : 0u;
  questions[index].target = pair.pair;
  questions[index].search = count;
  questions[index].matched = 0u;
  questions[index].gain = explained;
  questions[index].bias = 0.0;
}
