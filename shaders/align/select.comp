#version 460
// Keeps the best candidates of a start search (align/search/search.cpp): those where the images correlate most, in their
// order where they are equal. One of them becomes the first guess of the alignment.
// Groups: (pairs, 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer Starts { PairInfo starts[]; };          // of a pair: its own guess first
layout(set = 0, binding = 1, std430) readonly buffer Candidates { PairInfo candidates[]; };  // that were evaluated
layout(set = 0, binding = 2, std430) readonly buffer States { PairState states[]; };         // of the candidates
layout(set = 0, binding = 3, std430) buffer Kept { PairInfo kept[]; };
layout(push_constant) uniform Push { SelectPush push; };
#include "finite.glsl"
#include "align/moments.glsl"

shared float scores[ICLK_SEARCH_STARTS];

float score_of(uint candidate) {
  if (candidates[candidate].enabled == 0u) return -2.0;
  float masked = states[candidate].sums[4 * 14 + 2], visible = states[candidate].sums[4 * 14 + 1];
  float cost = states[candidate].sums[4 * 14];
  bool usable = masked > 0.0 && visible >= push.min_visible * masked && is_finite(cost) && cost < 1e30;
  return usable ? correlation_of(candidate) : -2.0;
}

void keep(uint from, uint pair, uint place) {
  uint start = pair * push.starts, to = pair * push.keep + place;
  if (starts[start].enabled == 0u && push.last != 0u) return;  // matching has found the start (match_pose.comp)
  bool usable = scores[from] > -2.0;
  if (push.last == 0u) {
    kept[to].reference = starts[start].reference;
    kept[to].target = pair;
    kept[to].enabled = usable ? starts[start].enabled : 0u;
    kept[to].has_prior = 0u;
    kept[to].search = 1u;
    kept[to].matched = 0u;
    kept[to].repeats = 0.0;
    kept[to].first_level = starts[start].first_level;
    kept[to].gain = 1.0;
    kept[to].bias = 0.0;
  }
  for (uint i = 0u; i < 12u; ++i)  // where nothing is usable the guess stays
    kept[to].pose[i] = usable ? states[pair * push.count + from].accepted_pose[i] : starts[start].pose[i];
}

void main() {
  uint pair = gl_WorkGroupID.x, lane = gl_LocalInvocationIndex, lanes = gl_WorkGroupSize.x;
  for (uint i = lane; i < push.count; i += lanes) scores[i] = score_of(pair * push.count + i);
  barrier();
  for (uint i = lane; i < push.count; i += lanes) {
    float mine = scores[i];
    uint better = 0u;
    for (uint j = 0u; j < push.count; ++j) better += scores[j] > mine || (scores[j] == mine && j < i) ? 1u : 0u;
    if (better < push.keep) keep(i, pair, better);
  }
}
