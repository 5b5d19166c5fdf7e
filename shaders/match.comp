#version 460
// Every feature against every place of the target: the best place of each tile. An invocation is a feature, its descriptors
// stay in registers, and all invocations read the same place at a time.
// Groups: (ceil(features / local size), tiles, pairs).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 1, std430) readonly buffer Pairs { PairInfo pairs[]; };
layout(set = 0, binding = 2) uniform samplerBuffer descriptors0;
layout(set = 0, binding = 3) uniform samplerBuffer descriptors1;
layout(set = 0, binding = 4, std430) writeonly buffer Matches { MatchInfo matches[]; };
layout(push_constant) uniform Push { MatchPush push; };

void main() {
  uint pair = gl_WorkGroupID.z, tile = gl_WorkGroupID.y, match = gl_GlobalInvocationID.x;
  if (pairs[pair].enabled == 0u) return;
  uint reference = pairs[pair].reference, features = push.features;
  uint count = min(references[reference].feature_count, features);
  if (gl_WorkGroupID.x * gl_WorkGroupSize.x >= count) return;
  int places_x = int(push.width) - ICLK_PATCH + 1, places_y = int(push.height) - ICLK_PATCH + 1;
  int tiles_x = (places_x + ICLK_MATCH_TILE - 1) / ICLK_MATCH_TILE;
  int left = int(tile) % tiles_x * ICLK_MATCH_TILE, top = int(tile) / tiles_x * ICLK_MATCH_TILE;
  int right = min(left + ICLK_MATCH_TILE, places_x), bottom = min(top + ICLK_MATCH_TILE, places_y);
  int base = int(pairs[pair].target) * places_x * places_y;
  int from = int((reference * features + min(match, count - 1u)) * ICLK_MATCH_ROLLS) * ICLK_MATCH_TEXELS;
#define LOAD(k)                                                                                                          \
  vec4 a##k = texelFetch(descriptors0, from + 4 * k), b##k = texelFetch(descriptors0, from + 4 * k + 1), \
       c##k = texelFetch(descriptors0, from + 4 * k + 2), d##k = texelFetch(descriptors0, from + 4 * k + 3);
  LOAD(0) LOAD(1) LOAD(2) LOAD(3) LOAD(4)
  float best = 0.0;
  int place = -1;
  for (int v = top; v < bottom; ++v)
    for (int u = left; u < right; ++u) {
      int at = v * places_x + u, texel = (base + at) * ICLK_MATCH_TEXELS;
      vec4 a = texelFetch(descriptors1, texel), b = texelFetch(descriptors1, texel + 1),
           c = texelFetch(descriptors1, texel + 2), d = texelFetch(descriptors1, texel + 3);
#define SCORE(k) (dot(a, a##k) + dot(b, b##k) + dot(c, c##k) + dot(d, d##k))
      float score = max(max(max(SCORE(0), SCORE(1)), max(SCORE(2), SCORE(3))), SCORE(4));
      place = score > best ? at : place;
      best = max(best, score);
    }
  if (match >= count) return;
  int tiles = tiles_x * ((places_y + ICLK_MATCH_TILE - 1) / ICLK_MATCH_TILE);
  uint to = (pair * uint(tiles) + tile) * features + match;
  matches[to].score = place >= 0 ? best : -2.0;
  matches[to].place = uint(max(place, 0));
}
