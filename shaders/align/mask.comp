#version 460
// Mask of a reference (align/solver/mask.h: sparse_mask): which pixels of its patch belong to a feature. A pixel in several
// patches belongs to the nearest feature, on a tie to the lower index. For every 8x8 block, the host lists the features that
// reach it, or may reach it (align/device/tiles.h). Each pixel finds its owner in the list of its block, and then writes the
// result for every feature of the list. The work is proportional to the number of features.
// Output: two words per patch row, because a row lies in two blocks. Bit i of their union is set if pixel i belongs to the
// feature.
// Groups: (n, references, m), n m >= ceil(8 tile_stride / local size); an invocation is a row of a block.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "shared.h"
layout(local_size_x_id = 0) in;
// Lavapipe (Mesa 22.3) stops the loops of an invocation after 65,535 iterations in all. CROWDED: an iteration processes four
// features.
layout(constant_id = 1) const bool CROWDED = false;
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 2, std430) readonly buffer FeatureList { vec4 features[]; };
layout(set = 0, binding = 3, std430) readonly buffer Tiles { uvec4 tiles[]; };  // MaskTile
layout(set = 0, binding = 4, std430) readonly buffer Entries { uint entries[]; };
layout(set = 0, binding = 5, std430) writeonly buffer Mask { uint mask[]; };
layout(push_constant) uniform Push { MaskPush push; };

const uint NOBODY = 0xffffffffu;
uint owner[ICLK_BLOCK];
float least[ICLK_BLOCK];

struct Row {
  ivec2 first;  // pixel
  float scale;  // of the level
  uint features_at, elements_at;
};

vec2 centre(Row row, uint feature) { return (features[row.features_at + feature].xy + 0.5) * row.scale - 0.5; }

// Strictly nearer: for ties the lower index stays, because lists are ascending.
void claim(Row row, uint feature) {
  vec2 c = centre(row, feature);
  ivec2 begin = ivec2(floor(c)) - ICLK_PATCH_BEFORE;
  bool in_rows = row.first.y >= begin.y && row.first.y < begin.y + ICLK_PATCH;
  float dv = float(row.first.y) - c.y;
  [[unroll]] for (int i = 0; i < ICLK_BLOCK; ++i) {
    int u = row.first.x + i;
    float du = float(u) - c.x;
    precise float d = du * du + dv * dv;
    if (in_rows && u >= begin.x && u < begin.x + ICLK_PATCH && d < least[i]) {
      least[i] = d;
      owner[i] = feature;
    }
  }
}

void tell(Row row, uint feature) {
  ivec2 offset = ivec2(floor(centre(row, feature))) - ICLK_PATCH_BEFORE - row.first;  // of the patch
  uint bits = 0u;
  [[unroll]] for (int i = 0; i < ICLK_BLOCK; ++i) bits |= owner[i] == feature ? 1u << i : 0u;
  if (offset.y > 0 || offset.y <= -ICLK_PATCH || abs(offset.x) >= ICLK_BLOCK) return;
  uint at = 2u * (row.elements_at / ICLK_PATCH + feature * ICLK_PATCH + uint(-offset.y));
  // The left one of two blocks writes the first word. A single block also writes the second word.
  if (offset.x >= 0) mask[at] = bits >> offset.x;
  if (offset.x <= 0) mask[at + 1u] = offset.x < 0 ? bits << -offset.x : 0u;
}

void main() {
  uint reference = push.first_reference + gl_WorkGroupID.y;
  uint index = (gl_WorkGroupID.z * gl_NumWorkGroups.x * gl_WorkGroupSize.x + gl_GlobalInvocationID.x) / ICLK_BLOCK;
  if (index >= references[reference].tile_count) return;
  uvec4 tile = tiles[reference * push.tile_stride + index];
  uint level = tile.y, first = reference * push.entry_stride + tile.z, count = tile.w, last = first + count - 1u;
  LevelInfo info = levels[level];
  Row row;
  row.first = (ivec2(tile.x & 0xffffu, tile.x >> 16) - 1) * ICLK_BLOCK + ivec2(0, gl_GlobalInvocationID.x % ICLK_BLOCK);
  row.scale = 1.0 / float(1u << level);
  row.features_at = reference * push.max_features;
  row.elements_at = reference * push.element_stride + info.element_offset;

  bool in_image = row.first.y >= 0 && row.first.y < int(info.height);
  [[unroll]] for (int i = 0; i < ICLK_BLOCK; ++i) {
    int u = row.first.x + i;
    owner[i] = NOBODY;
    least[i] = in_image && u >= 0 && u < int(info.width) ? 1e30 : -1.0;
  }
  const uint step = CROWDED ? 4u : 1u;
  for (uint k = first; k <= last; k += step) {
    claim(row, entries[k]);
    if (CROWDED) {
      claim(row, entries[min(k + 1u, last)]);
      claim(row, entries[min(k + 2u, last)]);
      claim(row, entries[min(k + 3u, last)]);
    }
  }
  for (uint k = first; k <= last; k += step) {
    tell(row, entries[k]);
    if (CROWDED) {
      tell(row, entries[min(k + 1u, last)]);
      tell(row, entries[min(k + 2u, last)]);
      tell(row, entries[min(k + 3u, last)]);
    }
  }
}
