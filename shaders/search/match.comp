#version 460
// Matches every feature with every place of the target, and finds the best place of each tile, or of each cell of it. An
// invocation processes all rolls of a feature, or as many upright features. Their descriptors stay in registers, and all
// invocations read the same place at a time.
// Groups: (ceil(invocations / local size), tiles, pairs).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "texels.glsl"
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const bool upright = false;
layout(constant_id = 2) const int cell = ICLK_MATCH_TILE;  // places; divides a tile
layout(constant_id = 3) const bool warped = false;         // descriptors of pairs, not of references
layout(set = 0, binding = 0, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 1, std430) readonly buffer Pairs { PairInfo pairs[]; };
TEXELS(2, vec4, descriptors0)
TEXELS(3, vec4, descriptors1)
layout(set = 0, binding = 4, std430) writeonly buffer Matches { MatchInfo matches[]; };
layout(push_constant) uniform Push { MatchPush push; };
#include "search/match_features.glsl"
#include "search/match_pair.glsl"

void main() {
  uint pair = gl_WorkGroupID.z, tile = gl_WorkGroupID.y;
  uint match = gl_GlobalInvocationID.x * (upright ? uint(ICLK_MATCH_ROLLS) : 1u);
  if (!takes_part(pair)) return;
  uint reference = pairs[pair].reference, features = push.features;
  uint taking_part = min(references[reference].feature_count, features), count = min(taking_part, push.sought);
  if (warped) taking_part = count = min(count, pairs[pair].search);
  if (match >= count) return;
  int places_x = int(push.width) - ICLK_PATCH + 1, places_y = int(push.height) - ICLK_PATCH + 1;
  int tiles_x = (places_x + ICLK_MATCH_TILE - 1) / ICLK_MATCH_TILE;
  int left = int(tile) % tiles_x * ICLK_MATCH_TILE, top = int(tile) / tiles_x * ICLK_MATCH_TILE;
  int right = min(left + ICLK_MATCH_TILE, places_x), bottom = min(top + ICLK_MATCH_TILE, places_y);
  int base = int(pairs[pair].target) * places_x * places_y;
  int from = int((warped ? pair : reference) * features) * ICLK_MATCH_ROLLS;
  int cells_x = (places_x + cell - 1) / cell, cells = cells_x * ((places_y + cell - 1) / cell);
#define slot(k) int(sought_feature(min(match + uint(k), count - 1u), taking_part, count))
#define FROM(k) \
  (from + (upright ? slot(k) * ICLK_MATCH_ROLLS + ICLK_MATCH_ROLLS / 2 : slot(0) * ICLK_MATCH_ROLLS + k)) * \
      ICLK_MATCH_TEXELS
#define LOAD(k)                                                                                                       \
  int from##k = FROM(k);                                                                                              \
  vec4 a##k = TEXEL(descriptors0, from##k), b##k = TEXEL(descriptors0, from##k + 1),                        \
       c##k = TEXEL(descriptors0, from##k + 2), d##k = TEXEL(descriptors0, from##k + 3);
  LOAD(0) LOAD(1) LOAD(2) LOAD(3) LOAD(4)
  for (int top_place = top; top_place < bottom; top_place += cell)
    for (int left_place = left; left_place < right; left_place += cell) {
      float best0 = 0.0, best1 = 0.0, best2 = 0.0, best3 = 0.0, best4 = 0.0;
      int place0 = -1, place1 = -1, place2 = -1, place3 = -1, place4 = -1;
      for (int v = top_place; v < min(top_place + cell, bottom); ++v)
        for (int u = left_place; u < min(left_place + cell, right); ++u) {
          int at = v * places_x + u, texel = (base + at) * ICLK_MATCH_TEXELS;
          vec4 a = TEXEL(descriptors1, texel), b = TEXEL(descriptors1, texel + 1),
               c = TEXEL(descriptors1, texel + 2), d = TEXEL(descriptors1, texel + 3);
#define SCORE(k) float score##k = dot(a, a##k) + dot(b, b##k) + dot(c, c##k) + dot(d, d##k);
#define KEEP(k)                                   \
  place##k = score##k > best##k ? at : place##k; \
  best##k = max(best##k, score##k);
          SCORE(0) SCORE(1) SCORE(2) SCORE(3) SCORE(4)
          if (upright) {
            KEEP(0) KEEP(1) KEEP(2) KEEP(3) KEEP(4)
          } else {
            score0 = max(max(max(score0, score1), max(score2, score3)), score4);
            KEEP(0)
          }
        }
      uint to = (pair * uint(cells) + uint(top_place / cell * cells_x + left_place / cell)) * features;
#define STORE(k)                                                            \
  if (match + k < count) {                                                  \
    matches[to + match + k].score = place##k >= 0 ? best##k : -2.0;         \
    matches[to + match + k].place = uint(max(place##k, 0));                 \
  }
      STORE(0)
      if (upright) {
        STORE(1) STORE(2) STORE(3) STORE(4)
      }
    }
}
