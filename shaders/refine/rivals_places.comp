#version 460
// Finds other places that look like each feature, and decides whether to compute a pose from them: look_elsewhere() of
// refine/internal/rivals.cpp.
// Output: correspondences in the layout of search/correspond.comp, the most similar first, with a resolution of 1/64.
// Groups: (pairs, 1, 1).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "shared.h"
#include "refine/refine.h"
#include "texels.glsl"
layout(local_size_x = ICLK_REFINE_GROUP) in;
layout(set = 0, binding = 0, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 1, std430) buffer Questions { PairInfo questions[]; };
layout(set = 0, binding = 2, std430) buffer Sought { vec4 sought[]; };
layout(set = 0, binding = 3, std430) readonly buffer Cells { MatchInfo cells[]; };
TEXELS(4, vec4, descriptors0)
TEXELS(5, vec4, descriptors1)
layout(set = 0, binding = 6, std430) writeonly buffer Correspondences { vec4 correspondences[]; };
layout(push_constant) uniform Push { RivalPush push; };

const float LEAST_SCORE = 0.5, WORSE = 0.2, CLEAR = 0.8, CLEARLY_BETTER = 0.15, OWN = 3.0;
const float ALIKE = 0.15, NOWHERE = 1e30;
const uint BINS = 32u, LANES = ICLK_REFINE_GROUP;
shared uint slots[BINS * LANES], totals[BINS], alike, seen;

uint pair;
int places_x, places_y, cells_x, cells_y;
vec2 own;

vec2 at_place(uint place) { return vec2(int(place) % places_x, int(place) / places_x) + 3.5; }
bool is_own(vec2 at) { return max(abs(own.x - at.x), abs(own.y - at.y)) <= OWN; }
MatchInfo cell_at(int x, int y, uint match) {
  return cells[(pair * uint(cells_x * cells_y) + uint(y * cells_x + x)) * push.features + match];
}

// The best score of the places near its own.
float score_here(uint match) {
  int from = int(((pair * push.features + match) * ICLK_MATCH_ROLLS + ICLK_MATCH_ROLLS / 2) * ICLK_MATCH_TEXELS);
  vec4 t0 = TEXEL(descriptors0, from), t1 = TEXEL(descriptors0, from + 1), t2 = TEXEL(descriptors0, from + 2),
       t3 = TEXEL(descriptors0, from + 3);
  ivec2 centre = ivec2(clamp(floor(own - 3.0), vec2(-9.0), vec2(65536.0)));
  float best = -1.0;
  [[dont_unroll]] for (int k = 0; k < 9; ++k) {
    ivec2 at = centre + ivec2(k % 3 - 1, k / 3 - 1);
    bool inside = at.x >= 0 && at.y >= 0 && at.x < places_x && at.y < places_y;
    int place = int(questions[pair].target) * places_x * places_y + (inside ? at.y * places_x + at.x : 0);
    int texel = place * ICLK_MATCH_TEXELS;
    float score = dot(TEXEL(descriptors1, texel), t0) + dot(TEXEL(descriptors1, texel + 1), t1) +
                  dot(TEXEL(descriptors1, texel + 2), t2) + dot(TEXEL(descriptors1, texel + 3), t3);
    best = inside ? max(best, score) : best;
  }
  return best;
}

// Whether no place near it is better, apart from its own.
bool is_peak(int x, int y, MatchInfo here, vec2 at, uint match) {
  bool peak = true;
  [[dont_unroll]] for (int k = 0; k < 9; ++k) {
    int nx = clamp(x + k % 3 - 1, 0, cells_x - 1), ny = clamp(y + k / 3 - 1, 0, cells_y - 1);
    MatchInfo other = cell_at(nx, ny, match);
    vec2 there = at_place(other.place);
    bool better = other.score > here.score || (other.score == here.score && other.place < here.place);
    bool near = max(abs(there.x - at.x), abs(there.y - at.y)) <= float(ICLK_ELSEWHERE_CELL);
    peak = peak && !(better && near && !is_own(there));
  }
  return peak;
}

// Writes the places of a feature after its other data: (u, v, score, -); score 0: none.
void find_places(uint match) {
  uint to = (pair * push.features + match) * ICLK_ELSEWHERE_STRIDE;
  vec4 wanted = sought[to];
  own = wanted.xy;
  float most = -2.0;
  for (int y = 0; y < cells_y; ++y)
    for (int x = 0; x < cells_x; ++x) most = max(most, cell_at(x, y, match).score);
  float least = wanted.w == 0.0 ? NOWHERE : max(LEAST_SCORE, most - WORSE);
  vec3 first = vec3(0.0), second = vec3(0.0);
  vec3 near[6] = vec3[6](vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0));
  float distances[6] = float[6](NOWHERE, NOWHERE, NOWHERE, NOWHERE, NOWHERE, NOWHERE);
  for (int y = 0; y < cells_y; ++y)
    for (int x = 0; x < cells_x; ++x) {
      MatchInfo here = cell_at(x, y, match);
      if (!(here.score > least)) continue;
      vec2 at = at_place(here.place);
      if (is_own(at) || !is_peak(x, y, here, at, match)) continue;
      vec3 next = vec3(at, here.score), swapped;
      if (next.z > first.z) {
        swapped = first;
        first = next;
        next = swapped;
      }
      if (next.z > second.z) {
        swapped = second;
        second = next;
        next = swapped;
      }
      float distance = next.z > 0.0 ? dot(next.xy - own, next.xy - own) : NOWHERE;
#define KEEP(k)                          \
  if (distance < distances[k]) {         \
    float farther = distances[k];        \
    swapped = near[k];                   \
    near[k] = next;                      \
    distances[k] = distance;             \
    next = swapped;                      \
    distance = farther;                  \
  }
      KEEP(0) KEEP(1) KEEP(2) KEEP(3) KEEP(4) KEEP(5)
    }
  sought[to + 4u] = vec4(first, 0.0);
  sought[to + 5u] = vec4(second, 0.0);
#define WRITE(k) sought[to + 6u + k] = vec4(near[k], 0.0);
  WRITE(0) WRITE(1) WRITE(2) WRITE(3) WRITE(4) WRITE(5)
  if (first.z == 0.0) return;
  float here = score_here(match);
  if (first.z > here - WORSE) atomicAdd(alike, 1u);
  if (wanted.z == 0.0 && first.z > CLEAR && first.z > here + CLEARLY_BETTER) atomicAdd(seen, 1u);
}

uint bin_of(float score) { return uint(clamp((1.0 - score) * 64.0, 0.0, float(BINS - 1u))); }

void main() {
  uint lane = gl_LocalInvocationID.x;
  pair = gl_WorkGroupID.x;
  if (questions[pair].enabled == 0u) return;
  uint count = questions[pair].search;
  places_x = int(push.width) - ICLK_PATCH + 1;
  places_y = int(push.height) - ICLK_PATCH + 1;
  cells_x = (places_x + ICLK_ELSEWHERE_CELL - 1) / ICLK_ELSEWHERE_CELL;
  cells_y = (places_y + ICLK_ELSEWHERE_CELL - 1) / ICLK_ELSEWHERE_CELL;
  for (uint b = 0u; b < BINS; ++b) slots[b * LANES + lane] = 0u;
  if (lane == 0u) alike = seen = 0u;
  barrier();
  for (uint match = lane; match < count; match += LANES) {
    find_places(match);
    uint from = (pair * push.features + match) * ICLK_ELSEWHERE_STRIDE + 4u;
    for (uint k = 0u; k < ICLK_ELSEWHERE_PLACES; ++k)
      if (sought[from + k].z > 0.0) slots[bin_of(sought[from + k].z) * LANES + lane] += 1u;
  }
  barrier();
  uint total = 0u;
  if (lane < BINS) {
    for (uint i = 0u; i < LANES; ++i) total += slots[lane * LANES + i];
    totals[lane] = total;
  }
  barrier();
  if (lane < BINS) {  // the number of earlier ones
    uint before = 0u;
    for (uint b = 0u; b < lane; ++b) before += totals[b];
    for (uint i = 0u; i < LANES; ++i) {
      uint n = slots[lane * LANES + i];
      slots[lane * LANES + i] = before;
      before += n;
    }
  }
  barrier();
  uint header = 2u * pair * (ICLK_ELSEWHERE_PLACES * push.features + 1u);
  for (uint match = lane; match < count; match += LANES) {
    uint from = (pair * push.features + match) * ICLK_ELSEWHERE_STRIDE;
    for (uint k = 0u; k < ICLK_ELSEWHERE_PLACES; ++k) {
      vec3 place = sought[from + 4u + k].xyz;
      if (!(place.z > 0.0)) continue;
      uint slot = slots[bin_of(place.z) * LANES + lane]++;
      correspondences[header + 2u * (slot + 1u)] = vec4(sought[from + 3u].xyz, place.z);
      correspondences[header + 2u * (slot + 1u) + 1u] = vec4((place.xy + 0.5) * float(push.scale) - 0.5, 0.0, 0.0);
    }
  }
  if (lane != 0u) return;
  uint all = 0u;
  for (uint b = 0u; b < BINS; ++b) all += totals[b];
  correspondences[header] = vec4(float(all), 0.0, 0.0, 0.0);
  bool settled = questions[pair].gain >= ICLK_ELSEWHERE_EXPLAINED && float(alike) < ALIKE * float(count);
  questions[pair].enabled = settled ? 0u : 1u;
  questions[pair].bias = float(seen);
}
