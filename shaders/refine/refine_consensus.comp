#version 460
// If many depths are wrong, a descent from the pose of all features ends between the right ones and the wrong ones. Therefore
// each invocation draws sets of three features, and keeps the pose with the least cost over all features: consensus() of
// refine/pose.cpp. refine_pose.comp also starts there.
// Groups: (pairs, 1, 1).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#define ICLK_LISTS_OBSERVATIONS
#include "refine/observations.glsl"
layout(set = 0, binding = 7, std430) readonly buffer Tasks { FeatureTask tasks[]; };
#include "refine/whiten.glsl"
#include "search/p3p.glsl"
#include "search/three_of.glsl"

shared uint counts[ICLK_REFINE_GROUP];
shared vec4 rays[ICLK_REFINE_GROUP];    // x, y at depth 1, inverse depth, used
shared vec4 places[ICLK_REFINE_GROUP];  // u1, v1, W_uu, W_vv
shared float skew[ICLK_REFINE_GROUP];   // W_uv
shared float costs[ICLK_REFINE_GROUP];

// Entry k of the list becomes the k-th used feature.
void list_observations() {
  uint each = (pair.feature_count + ICLK_REFINE_GROUP - 1u) / ICLK_REFINE_GROUP;
  uint first = pair.first_feature + min(lane * each, pair.feature_count),
       last = pair.first_feature + min((lane + 1u) * each, pair.feature_count);
  uint n = 0u;
  memoryBarrierBuffer();
  barrier();
  for (uint i = first; i < last; ++i) n += observations[i].used;
  counts[lane] = n;
  barrier();
  uint to = pair.first_feature;
  for (uint k = 0u; k < lane; ++k) to += counts[k];
  for (uint i = first; i < last; ++i)
    if (observations[i].used != 0u) observations[to++].listed = i;
  memoryBarrierBuffer();
  barrier();
}

vec3 point_of(uint i) { return project(feature_at(i), Pose(mat3(1.0), vec3(0.0))).ray / feature_at(i).inverse_depth; }

vec3 ray_of(uint i) {
  vec2 at = (position_of(i) - vec2(reference.cx, reference.cy)) / vec2(reference.fx, reference.fy);
  return normalize(vec3(at, 1.0));
}

void load(uint from) {
  uint i = from + lane;
  bool takes_part = i < pair.first_feature + pair.feature_count && observations[i].used != 0u;
  barrier();
  rays[lane] = vec4(0.0);
  if (takes_part) {
    vec3 W = W_of(i);
    FeatureInfo f = feature_at(i);
    rays[lane] = vec4(project(f, Pose(mat3(1.0), vec3(0.0))).ray.xy, f.inverse_depth, 1.0);
    places[lane] = vec4(position_of(i), W.x, W.z);
    skew[lane] = W.y;
  }
  barrier();
}

// The cost of each invocation's pose over all features.
float cost_of(Pose T) {
  float cost = 0.0, scale = 1.0 / (ICLK_SHARP * ICLK_SHARP);
  vec2 focal = vec2(reference.fx, reference.fy), principal = vec2(reference.cx, reference.cy);
  [[dont_unroll]] for (uint from = 0u; from < pair.feature_count; from += ICLK_REFINE_GROUP) {
    load(pair.first_feature + from);
    uint n = min(pair.feature_count - from, uint(ICLK_REFINE_GROUP));
    [[dont_unroll]] for (uint k = 0u; k < n; ++k) {
      vec4 ray = rays[k], at = places[k];
      vec3 p = T.R * vec3(ray.xy, 1.0) + ray.z * T.t;
      bool in_front = p.z > ICLK_LEAST_DEPTH;
      vec2 r = p.xy / (in_front ? p.z : 1.0) * focal + principal - at.xy;
      vec2 w = whitened(vec3(at.z, skew[k], at.w), r);
      cost += ray.w == 0.0 ? 0.0 : in_front ? log(1.0 + scale * dot(w, w)) : INFINITE;
    }
  }
  return cost;
}

void main() {
  uint index = gl_WorkGroupID.x;
  begin(index);
  if (tasks[index].feature_count == 0u) return;
  Pose T = scaled(pose_of(tasks[index].pose), pair.unit), best = T;
  uint used = uint(observe(T));
  if (lane == 0u) states[index].has_consensus = 0u;
  if (used < push.min_features) return;
  whiten(T, push.sigma, 0.0);
  list_observations();
  ivec3 drawn = three_of(used, lane);
  uint i = observations[pair.first_feature + drawn.x].listed, j = observations[pair.first_feature + drawn.y].listed,
       k = observations[pair.first_feature + drawn.z].listed;
  vec3 x1 = point_of(i), x2 = point_of(j), x3 = point_of(k), y1 = ray_of(i), y2 = ray_of(j), y3 = ray_of(k);
  vec3 d12 = x1 - x2, d13 = x1 - x3, d23 = x2 - x3, distances[4];
  int solutions = p3p_distances(y1, y2, y3, dot(d12, d12), dot(d13, d13), dot(d23, d23), distances);
  float least = INFINITE;
  [[dont_unroll]] for (int s = 0; s < 4; ++s) {
    vec3 l = distances[min(s, max(solutions - 1, 0))];
    T = pose_of_triangles(x1, x2, x3, l.x * y1, l.y * y2, l.z * y3);
    float cost = cost_of(T);
    if (s < solutions && cost < least) {
      least = cost;
      best = T;
    }
  }
  costs[lane] = least;
  barrier();
  bool mine = least < INFINITE;
  for (uint n = 0u; n < ICLK_REFINE_GROUP; ++n) mine = mine && (least < costs[n] || (least == costs[n] && lane <= n));
  if (!mine) return;
  best.R = orthonormalized(best.R);
  states[index].consensus = floats_of(best);
  states[index].has_consensus = 1u;
}
