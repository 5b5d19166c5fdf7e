#version 460
// Winograd F(4x1, 3x3) for CPUs. Workgroups take work items from a counter (work_items.glsl). For a reduced layer, only 2x2
// means and the map (the mean over all channels) are written. An item is eight columns, or a multiple, of the rows of two
// tiles, and some output channels; for a reduced layer all channels.
// Groups: at least as many as items, of eight lanes.
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#define SHUFFLE
#define ITEMS
layout(constant_id = 1) const bool REDUCED = false;
// The two tiles are of neighbouring phases of an even dilation: together they have whole 2x2 blocks.
layout(constant_id = 2) const bool PAIRED = false;
// Rows of the map and the requested pixels begin and end at multiples of four, or end with the row.
layout(constant_id = 3) const bool WHOLE = false;
#include "convolution/conv_column.glsl"
layout(set = 0, binding = 4, std430) writeonly buffer MapRows0 { vec4 map_rows_0[]; };
layout(set = 0, binding = 4, std430) writeonly buffer Map0 { float map_0[]; };
layout(set = 0, binding = 5, std430) writeonly buffer MapRows1 { vec4 map_rows_1[]; };
layout(set = 0, binding = 5, std430) writeonly buffer Map1 { float map_1[]; };
#include "convolution/work_items.glsl"
#include "convolution/winograd4x1_sums.glsl"

// The first row of pair j of the invocation; `y`: that of its first tile.
int row_pair(int y, int j) { return PAIRED ? y + j * int(push.dilation) : y + 2 * j; }

// Writes means of the block's channels for four pairs of rows. `sums`: over the channels so far, for the upper and the lower
// row of each. Lanes of neighbouring columns share the work: the even one writes four channels, the odd one the other four.
void write_means(uint block, vec4 acc[T][6][2], int image, int x, int y, inout vec2 sums[4]) {
  int height = int(push.height);
  bool odd = gl_SubgroupInvocationID % 2u == 1u;
  uint neighbour = gl_SubgroupInvocationID ^ 1u, out_planes = push.out_planes;
  vec4 means[4][2];
  [[unroll]] for (int h = 0; h < 2; ++h) {
    vec4 bias = TEXEL(weights, int(push.bias + min(2u * block + uint(h), out_planes - 1u)));
    vec4 first[4] = pixels_of(acc[0], h), second[4] = pixels_of(acc[1], h);
    bool exists = 2u * block + uint(h) < out_planes;
    [[unroll]] for (int j = 0; j < 4; ++j) {
      vec4 upper = PAIRED ? first[j] : j < 2 ? first[2 * j % 4] : second[2 * j % 4];
      vec4 lower = PAIRED ? second[j] : j < 2 ? first[2 * j % 4 + 1] : second[2 * j % 4 + 1];
      upper = elu(upper + bias);
      lower = elu(lower + bias);
      means[j][h] = upper + lower;
      if (exists) sums[j] += vec2((upper.x + upper.y) + (upper.z + upper.w), (lower.x + lower.y) + (lower.z + lower.w));
    }
  }
  uint plane = 2u * block + uint(odd);
  bool halves = push.halves != 0u && plane < out_planes && x - x % 2 + 1 < int(push.width);
  int to = int(push.out_offset) + image * int(push.out_image) + int(plane * push.out_plane) + x / 2;
  int pitch = int(push.out_pitch);
  [[unroll]] for (int j = 0; j < 4; ++j) {
    int v = row_pair(y, j);
    vec4 others = subgroupShuffle(odd ? means[j][0] : means[j][1], neighbour);
    vec4 mean = 0.25 * ((odd ? means[j][1] : means[j][0]) + others);
    if (halves && v + 1 < height) put(uint(to + v / 2 * pitch), mean);
  }
}

void write_four(int image, int at, vec4 four, int x, bool exists) {
  bool other = image >= int(push.split);
  if (WHOLE) {
    bool inside = exists && x >= int(push.first_u) && x < int(push.end_u);
    if (inside && !other) map_rows_0[at / 4] = four;
    if (inside && other) map_rows_1[at / 4] = four;
  } else {
    [[unroll]] for (int k = 0; k < 4; ++k) {
      bool inside = exists && x + k >= int(push.first_u) && x + k < int(push.end_u);
      if (inside && !other) map_0[at + k] = four[k];
      if (inside && other) map_1[at + k] = four[k];
    }
  }
}

// Each of four lanes has four pairs of rows of a column. After an exchange it has a pair of rows of four columns, for a single
// store.
void write_map(int image, int x, int y, vec2 sums[4]) {
  uint lane = gl_SubgroupInvocationID;
  bool odd = (lane & 1u) != 0u, high = (lane & 2u) != 0u;
  vec4 two[2];  // columns; upper and lower row
  [[unroll]] for (int m = 0; m < 2; ++m) {
    vec2 own = odd ? sums[2 * m + 1] : sums[2 * m], other = subgroupShuffle(odd ? sums[2 * m] : sums[2 * m + 1], lane ^ 1u);
    vec2 left = odd ? other : own, right = odd ? own : other;
    two[m] = vec4(left.x, right.x, left.y, right.y);
  }
  vec4 own = high ? two[1] : two[0], other = subgroupShuffle(high ? two[0] : two[1], lane ^ 2u);
  vec4 left = (high ? other : own) * push.inverse_channels, right = (high ? own : other) * push.inverse_channels;
  int v = row_pair(y, int(lane & 3u)), first_v = int(push.first_v), end_v = int(push.end_v);
  int number = image < int(push.split) ? int(push.first_image[0]) + image : int(push.first_image[1]) + image - int(push.split);
  x -= x % 4;
  int pitch = int(push.map_pitch), at = int(push.map_offset) + number * int(push.map_stride) + v * pitch + x;
  write_four(image, at, vec4(left.xy, right.xy), x, v >= first_v && v < end_v);
  write_four(image, at + pitch, vec4(left.zw, right.zw), x, v + 1 >= first_v && v + 1 < end_v);
}

void main() {
  push = constants;
  uint item = take_item(push.counter);
  int width = int(push.width), dilation = int(push.dilation), lanes = int(gl_WorkGroupSize.x);
  uint blocks = (push.out_planes + 1u) / 2u, parts = (blocks + push.item_blocks - 1u) / push.item_blocks;
  uint steps = (push.width + gl_WorkGroupSize.x - 1u) / gl_WorkGroupSize.x;
  uint chunks = (steps + push.item_steps - 1u) / push.item_steps;
  // Rows of tiles. With pairs there are half as many phases, of half the length.
  int phases = PAIRED ? dilation / 2 : dilation, span = (PAIRED ? 4 : 4 * T) * dilation;
  int row_blocks = (int(push.height) + span - 1) / span * phases;
  uint rest = item / parts, first_block = (item - rest * parts) * push.item_blocks;
  uint end_block = min(first_block + push.item_blocks, blocks);
  int row = int(rest / chunks), image = row / row_blocks;
  uint step = (rest - uint(row) * chunks) * push.item_steps, end = min(step + push.item_steps, steps);
  row -= image * row_blocks;
  if (image >= int(push.images)) return;
  int y = row / phases * span + row % phases * (PAIRED ? 2 : 1);
  int rows[6 * T];
  find_rows(y, rows);
  int in_image = int(push.in_offset) + image * int(push.in_image);
  do {
    int x = int(step) * lanes + int(gl_LocalInvocationIndex);
    uint block = first_block;
    vec2 sums[4] = vec2[4](vec2(0.0), vec2(0.0), vec2(0.0), vec2(0.0));
    do {
      vec4 acc[T][6][2];
      sums_of(block, in_image + min(x, width - 1), rows, acc);
      if (REDUCED)
        write_means(block, acc, image, x, y, sums);
      else if (x < width)
        write_whole(block, acc, image, x, y);
    } while (++block < end_block);
    if (REDUCED) write_map(image, x, y, sums);
  } while (++step < end);
}
