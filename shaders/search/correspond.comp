#version 460
// The best place of every feature in the whole target, to a fraction of a pixel: correspondences of points of camera 0 with
// pixels of image 1, the most distinct first. Lengths are times the mean inverse depth.
// Groups: (1, 1, pairs).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "texels.glsl"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 1, std430) readonly buffer Pairs { PairInfo pairs[]; };
layout(set = 0, binding = 2, std430) readonly buffer FeatureList { vec4 features[]; };
layout(set = 0, binding = 3, std430) readonly buffer Matches { MatchInfo matches[]; };
TEXELS(4, vec4, descriptors0)
TEXELS(5, vec4, descriptors1)
// Of a pair (count, share that repeats, -, -) and (-), then of each correspondence (point, how distinct) and (u, v, -, -).
layout(set = 0, binding = 6, std430) writeonly buffer Correspondences { vec4 correspondences[]; };
layout(push_constant) uniform Push { MatchPush push; };
#include "search/match_features.glsl"
#include "search/match_pair.glsl"

shared vec3 found[ICLK_MATCH_FEATURES];  // u, v, how distinct; -2: not found

int places_x, places_y, base;
vec4 t0, t1, t2, t3;  // of the feature

float score_at(int u, int v) {
  int texel = (base + v * places_x + u) * ICLK_MATCH_TEXELS;
  return dot(TEXEL(descriptors1, texel), t0) + dot(TEXEL(descriptors1, texel + 1), t1) +
         dot(TEXEL(descriptors1, texel + 2), t2) + dot(TEXEL(descriptors1, texel + 3), t3);
}

// The position of the maximum of the parabola through three neighbours.
float peak(float before, float here, float after) {
  float bend = before - 2.0 * here + after;
  return bend < 0.0 ? clamp(0.5 * (before - after) / bend, -0.5, 0.5) : 0.0;
}

void main() {
  uint pair = gl_WorkGroupID.z, lane = gl_LocalInvocationIndex, lanes = gl_WorkGroupSize.x;
  if (!takes_part(pair)) return;
  ReferenceInfo reference = references[pairs[pair].reference];
  uint taking_part = min(reference.feature_count, push.features), count = min(taking_part, push.sought);
  places_x = int(push.width) - ICLK_PATCH + 1;
  places_y = int(push.height) - ICLK_PATCH + 1;
  base = int(pairs[pair].target) * places_x * places_y;
  uint tiles_x = uint(places_x + ICLK_MATCH_TILE - 1) / ICLK_MATCH_TILE;
  uint tiles = tiles_x * (uint(places_y + ICLK_MATCH_TILE - 1) / ICLK_MATCH_TILE);
  uint of_pair = pair * tiles * push.features;
  for (uint match = lane; match < count; match += lanes) {
    float best = -2.0, next = 0.0;
    uint tile = 0u;
    for (uint k = 0u; k < tiles; ++k) {
      float score = matches[of_pair + k * push.features + match].score;
      tile = score > best ? k : tile;
      best = max(best, score);
    }
    // Neighbouring tiles may contain the slope of the same peak.
    for (uint k = 0u; k < tiles; ++k) {
      ivec2 apart = abs(ivec2(k % tiles_x, k / tiles_x) - ivec2(tile % tiles_x, tile / tiles_x));
      float score = matches[of_pair + k * push.features + match].score;
      next = max(apart.x, apart.y) > 1 ? max(next, score) : next;
    }
    int place = int(matches[of_pair + tile * push.features + match].place);
    int u = place % places_x, v = place / places_x;
    uint slot = sought_feature(match, taking_part, count);
    int from = int((pairs[pair].reference * push.features + slot) * ICLK_MATCH_ROLLS + push.first_roll) * ICLK_MATCH_TEXELS;
    int roll = from;
    float most = -2.0;
    for (uint k = 0u; k < push.rolls; ++k, from += ICLK_MATCH_TEXELS) {
      t0 = TEXEL(descriptors0, from);
      t1 = TEXEL(descriptors0, from + 1);
      t2 = TEXEL(descriptors0, from + 2);
      t3 = TEXEL(descriptors0, from + 3);
      float score = score_at(u, v);
      roll = score > most ? from : roll;
      most = max(most, score);
    }
    t0 = TEXEL(descriptors0, roll);
    t1 = TEXEL(descriptors0, roll + 1);
    t2 = TEXEL(descriptors0, roll + 2);
    t3 = TEXEL(descriptors0, roll + 3);
    vec2 at = vec2(u, v);
    if (u > 0 && u < places_x - 1) at.x += peak(score_at(u - 1, v), most, score_at(u + 1, v));
    if (v > 0 && v < places_y - 1) at.y += peak(score_at(u, v - 1), most, score_at(u, v + 1));
    // The middle of the patch, in pixels of the image.
    found[match] = best > 0.0 ? vec3((at + 0.5 * float(ICLK_PATCH)) * float(push.scale) - 0.5, best - next)
                              : vec3(0.0, 0.0, -2.0);
  }
  barrier();
  uint header = 2u * pair * (push.features + 1u);
  if (lane == 0u) {
    uint usable = 0u, alike = 0u;
    for (uint k = 0u; k < count; ++k) {
      usable += found[k].z > -2.0 ? 1u : 0u;
      alike += found[k].z > -2.0 && found[k].z < ICLK_MATCH_ALIKE ? 1u : 0u;
    }
    correspondences[header] = vec4(float(usable), float(alike) / float(max(usable, 1u)), 0.0, 0.0);
  }
  for (uint match = lane; match < count; match += lanes) {
    vec3 mine = found[match];
    uint rank = 0u;
    for (uint k = 0u; k < count; ++k) rank += found[k].z > mine.z || (found[k].z == mine.z && k < match) ? 1u : 0u;
    uint index = feature_of(sought_feature(match, taking_part, count), reference.feature_count);
    vec4 feature = features[pairs[pair].reference * push.max_features + index];
    float depth = feature.z > 0.0 ? reference.mean_inverse_depth / feature.z : 0.0;
    vec3 ray = vec3((feature.x - reference.cx) / reference.fx, (feature.y - reference.cy) / reference.fy, 1.0);
    uint to = header + 2u * (rank + 1u);
    correspondences[to] = vec4(ray * depth, mine.z);
    correspondences[to + 1u] = vec4(mine.xy, 0.0, 0.0);
  }
}
