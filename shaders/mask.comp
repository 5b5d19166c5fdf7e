#version 460
// Mask and inverse depth of a reference (align/internal/mask.h: sparse_mask): for each pixel of each feature's patch, the
// feature's inverse depth if the pixel belongs to it, else 0. A pixel in several patches belongs to the nearest feature,
// on a tie to the lower index: a minimum over the features whose patches meet this one, so no order and no atomics matter.
// Groups: (max_features, levels, references); 64 invocations, one a patch pixel.
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x = ICLK_PATCH_AREA) in;
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 2, std430) readonly buffer FeatureList { vec4 features[]; };
layout(set = 0, binding = 3, std430) writeonly buffer Mask { float mask[]; };
layout(push_constant) uniform Push { MaskPush push; };

shared uint neighbours[ICLK_PATCH_AREA];
shared uint neighbour_count;

vec2 centre(uint reference, uint feature, float scale) {
  return (features[reference * push.max_features + feature].xy + 0.5) * scale - 0.5;
}

void main() {
  uint feature = gl_WorkGroupID.x, level = gl_WorkGroupID.y, reference = push.first_reference + gl_WorkGroupID.z;
  uint lane = gl_LocalInvocationIndex;
  LevelInfo info = levels[level];
  uint count = references[reference].feature_count;
  float scale = 1.0 / float(1u << level);
  float q = features[reference * push.max_features + feature].z;
  bool alive = feature < count && q > 0.0;

  vec2 c = centre(reference, feature, scale);
  ivec2 first = ivec2(floor(c)) - ICLK_PATCH_BEFORE;
  ivec2 pixel = first + ivec2(lane % ICLK_PATCH, lane / ICLK_PATCH);
  bool mine = alive && all(greaterThanEqual(pixel, ivec2(0))) && pixel.x < int(info.width) && pixel.y < int(info.height);
  vec2 d = vec2(pixel) - c;
  precise float distance2 = d.x * d.x + d.y * d.y;

  // The list of neighbours is worked off in chunks, so that any number of features fits into shared memory.
  for (uint base = 0u; base < count; base += ICLK_PATCH_AREA) {
    if (lane == 0u) neighbour_count = 0u;
    barrier();
    uint other = base + lane;
    if (other < count && other != feature && features[reference * push.max_features + other].z > 0.0) {
      ivec2 offset = ivec2(floor(centre(reference, other, scale))) - ICLK_PATCH_BEFORE - first;
      if (all(lessThan(abs(offset), ivec2(ICLK_PATCH)))) neighbours[atomicAdd(neighbour_count, 1u)] = other;
    }
    barrier();
    uint n = neighbour_count;
    for (uint i = 0u; i < n; ++i) {
      uint j = neighbours[i];
      vec2 cj = centre(reference, j, scale);
      ivec2 inside = pixel - (ivec2(floor(cj)) - ICLK_PATCH_BEFORE);
      vec2 dj = vec2(pixel) - cj;
      precise float theirs = dj.x * dj.x + dj.y * dj.y;
      bool covered = all(greaterThanEqual(inside, ivec2(0))) && all(lessThan(inside, ivec2(ICLK_PATCH)));
      if (covered && (theirs < distance2 || (theirs == distance2 && j < feature))) mine = false;
    }
    barrier();
  }
  mask[reference * push.element_stride + info.element_offset + feature * ICLK_PATCH_AREA + lane] = mine ? q : 0.0;
}
