#version 460
// Compares answers with their rivals. The pose that dominates all others is the answer; without one the answer is ambiguous. It
// is also ambiguous if its features stand still while others are seen elsewhere. weigh(), prefer_confirmed() and
// doubt_stillness() of refine/internal/rivals.cpp. Groups: (pairs, 1, 1).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "shared.h"
#include "refine/refine.h"
#include "se3.glsl"
#include "refine/warp.glsl"
layout(local_size_x = ICLK_REFINE_GROUP) in;
layout(set = 0, binding = 0, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 1, std430) readonly buffer Pairs { RefinePair pairs[]; };
layout(set = 0, binding = 2, std430) readonly buffer FeatureList { FeatureInfo features[]; };
layout(set = 0, binding = 3, std430) buffer Aligned { AlignedInfo aligned[]; };
layout(set = 0, binding = 4, std430) buffer Refined { RefinedInfo refined[]; };
layout(set = 0, binding = 5, std430) readonly buffer RivalAligned { AlignedInfo rival_aligned[]; };
layout(set = 0, binding = 6, std430) readonly buffer RivalRefined { RefinedInfo rival_refined[]; };
layout(set = 0, binding = 7, std430) readonly buffer Questions { PairInfo questions[]; };
layout(push_constant) uniform Push { RivalPush push; };
#include "refine/rivals.glsl"

const uint POSES = 1u + ICLK_RIVALS;  // the answer's first
const uint SUMS = 6u;  // of features that only one pose explains: 1, u, v, uu, uv, vv in 256ths of the image
shared uint counts[2], sums[2u * SUMS];
shared bool dominates[POSES * POSES], apart[POSES * POSES];

uint lane, index;
RefinePair pair;
ReferenceInfo reference;

uint rival(uint p) { return (p - 1u) * push.pairs + index; }
Pose pose_at(uint p) { return p == 0u ? pose_of(refined[index].pose) : pose_of(rival_refined[rival(p)].pose); }
uint inliers_at(uint p) { return p == 0u ? refined[index].inliers : rival_refined[rival(p)].inliers; }
uint status_at(uint p) { return p == 0u ? refined[index].status : rival_refined[rival(p)].status; }
AlignedInfo found_at(uint p, uint i) {
  if (p == 0u) return aligned[pair.first_feature + i];
  return rival_aligned[rival(p) * push.max_features + i];
}

bool is_better(AlignedInfo one, AlignedInfo other) {  // by more than noise
  return 2.0 * (1.0 - one.correlation) + 0.005 < 1.0 - other.correlation;
}
bool is_shown(AlignedInfo found) { return found.status != OUT_OF_IMAGE && found.status != HIDDEN; }

// The number of these features times their extent: reach() of rivals.cpp, in another unit.
float support(uint side) {
  float n = float(sums[side * SUMS]);
  if (n < 3.0) return 0.0;
  vec2 mean = vec2(sums[side * SUMS + 1u], sums[side * SUMS + 2u]) / n;
  float uu = float(sums[side * SUMS + 3u]) / n - mean.x * mean.x, uv = float(sums[side * SUMS + 4u]) / n - mean.x * mean.y,
        vv = float(sums[side * SUMS + 5u]) / n - mean.y * mean.y;
  return n * sqrt(sqrt(max(uu * vv - uv * uv, 0.0)));
}

bool is_dominant(uint side, uint inliers) {
  return float(sums[side * SUMS]) >= max(float(push.min_inliers), 0.1 * float(inliers)) &&
         support(1u - side) <= push.max_rival_share * support(side);
}

void count(uint side, vec2 uv) {
  uvec2 at = uvec2(clamp(uv / vec2(push.width * push.scale, push.height * push.scale), 0.0, 1.0) * 256.0);
  uint values[SUMS] = uint[SUMS](1u, at.x, at.y, at.x * at.x, at.x * at.y, at.y * at.y);
  for (uint k = 0u; k < SUMS; ++k) atomicAdd(sums[side * SUMS + k], values[k]);
}

// The features that only one of two poses explains, and whether the poses differ.
void compare(uint p, uint q) {
  Pose Tp = pose_at(p), Tq = pose_at(q);
  if (lane < 2u) counts[lane] = 0u;
  if (lane < 2u * SUMS) sums[lane] = 0u;
  barrier();
  uvec2 n = uvec2(0u);
  for (uint i = lane; i < pair.feature_count; i += ICLK_REFINE_GROUP) {
    FeatureInfo f = features[pair.first_feature + i];
    if (!(f.inverse_depth > 0.0)) continue;
    AlignedInfo in_p = found_at(p, i), in_q = found_at(q, i);
    bool a = agrees(in_p, f, reference, Tp), b = agrees(in_q, f, reference, Tq);
    PatchWarp wp = warp_patch(f, reference, Tp), wq = warp_patch(f, reference, Tq);
    if (a && is_shown(in_q) && !(b && !is_better(in_p, in_q))) count(0u, vec2(f.u, f.v));
    if (b && is_shown(in_p) && !(a && !is_better(in_q, in_p))) count(1u, vec2(f.u, f.v));
    n.x += 1u;
    n.y += wp.valid && wq.valid && length(wp.uv1 - wq.uv1) <= push.inlier_distance ? 1u : 0u;
  }
  [[unroll]] for (int k = 0; k < 2; ++k) atomicAdd(counts[k], n[k]);
  barrier();
  if (lane == 0u) {
    dominates[p * POSES + q] = is_dominant(0u, inliers_at(p));
    dominates[q * POSES + p] = is_dominant(1u, inliers_at(q));
    apart[p * POSES + q] = apart[q * POSES + p] = counts[1] <= counts[0] / 2u;  // the median
  }
  barrier();
}

uint best_pose(bool is_refined) {
  uint best = 0u;
  for (uint p = 1u; p < POSES; ++p) {
    bool converged = status_at(p) == CONVERGED && rival_refined[rival(p)].rounds > 0u;
    bool wins = is_refined ? dominates[p * POSES + best] : best == 0u || inliers_at(p) > inliers_at(best);
    if (converged && wins) best = p;
  }
  return best;
}

void main() {
  lane = gl_LocalInvocationID.x;
  index = gl_WorkGroupID.x;
  pair = pairs[index];
  reference = references[pair.reference];
  bool is_refined = refined[index].refined != 0u;
  uint tried = 0u;
  for (uint p = 1u; p < POSES; ++p) tried += rival_refined[rival(p)].rounds > 0u ? 1u : 0u;
  if (pair.asks == 0u || status_at(0u) != CONVERGED) return;
  for (uint k = lane; k < POSES * POSES; k += ICLK_REFINE_GROUP) dominates[k] = apart[k] = false;
  barrier();
  [[dont_unroll]] for (uint k = 1u; k < POSES * POSES && tried > 0u; ++k)
    if (k / POSES < k % POSES) compare(k / POSES, k % POSES);

  uint best = best_pose(is_refined), count = 0u, rivals[ICLK_RIVALS];
  for (uint q = 0u; q < POSES && is_refined; ++q) {
    bool speaks = q != best && inliers_at(q) >= push.min_inliers && apart[best * POSES + q] && !dominates[best * POSES + q];
    if (!speaks) continue;
    uint at = count++;
    for (; at > 0u && inliers_at(rivals[at - 1u]) < inliers_at(q); --at) rivals[at] = rivals[at - 1u];
    rivals[at] = q;
  }
  Pose poses[ICLK_RIVALS];
  uint inliers[ICLK_RIVALS];
  for (uint k = 0u; k < count; ++k) {
    poses[k] = pose_at(rivals[k]);
    inliers[k] = inliers_at(rivals[k]);
  }
  is_refined = is_refined || best > 0u;
  Pose T = pose_at(best);
  if (lane == 0u) counts[0] = 0u;
  barrier();
  uint still = 0u;
  for (uint i = lane; i < pair.feature_count; i += ICLK_REFINE_GROUP) {
    AlignedInfo found = found_at(best, i);
    still += stands_still(found, features[pair.first_feature + i], reference, T, is_refined) ? 1u : 0u;
    if (best > 0u) aligned[pair.first_feature + i] = found;
  }
  atomicAdd(counts[0], still);
  memoryBarrierBuffer();
  barrier();
  if (lane != 0u) return;
  if (best > 0u) refined[index] = rival_refined[rival(best)];
  uint standing = counts[0];
  float of = float(is_refined ? refined[index].inliers : pair.feature_count), seen = questions[index].bias;
  bool doubted = count == 0u && refined[index].status == CONVERGED && standing >= push.min_inliers &&
                 float(standing) >= 0.25 * of && seen >= max(3.0, 0.02 * of);
  refined[index].standing = doubted ? standing : 0u;
  refined[index].seen = uint(seen);
  refined[index].rival_count = count;
  for (uint k = 0u; k < count; ++k) {
    refined[index].rival_inliers[k] = inliers[k];
    float row_major[12] = float[12](poses[k].R[0][0], poses[k].R[1][0], poses[k].R[2][0], poses[k].t.x, poses[k].R[0][1],
                                    poses[k].R[1][1], poses[k].R[2][1], poses[k].t.y, poses[k].R[0][2], poses[k].R[1][2],
                                    poses[k].R[2][2], poses[k].t.z);
    for (uint i = 0u; i < 12u; ++i) refined[index].rivals[12u * k + i] = row_major[i];
  }
  if (count == 0u && !doubted) return;
  refined[index].status = AMBIGUOUS;
  for (uint i = 0u; i < 36u; ++i) refined[index].covariance[i] = 0.0;
}
