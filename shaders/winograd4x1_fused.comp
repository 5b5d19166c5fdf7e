#version 460
// Winograd F(4x1, 3x3) for CPUs: workgroups take items of work from a counter (work_items.glsl), and of a level's last layer
// only 2x2 means and sums over eight channels are written. An item is eight columns, or some times as many, of the rows of two
// tiles, and some or all output channels.
// Groups: any number from that of the items on, of eight lanes.
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#define SHUFFLE
#define ITEMS
layout(constant_id = 2) const bool REDUCED = false;
// The two tiles are of neighbouring phases of an even dilation: together they have whole 2x2 blocks.
layout(constant_id = 3) const bool PAIRED = false;
#include "conv_column.glsl"
#include "work_items.glsl"
#include "winograd4x1_sums.glsl"

// Lanes of neighbouring columns share the work: the even one writes four channels of the means, the odd one the other four;
// the even one the sums of two pairs of rows, the odd one those of the other two.
void write_reduced(uint block, vec4 acc[T][6][2], int image, int x, int y) {
  int width = int(push.width), height = int(push.height), step = int(push.dilation);
  bool odd = gl_SubgroupInvocationID % 2u == 1u, live = x - x % 2 < width;
  uint neighbour = gl_SubgroupInvocationID ^ 1u, out_planes = push.out_planes;
  vec4 means[4][2];
  vec2 sums[4];  // of the upper and the lower pixel
  [[unroll]] for (int j = 0; j < 4; ++j) sums[j] = vec2(0.0);
  [[unroll]] for (int h = 0; h < 2; ++h) {
    vec4 bias = texelFetch(weights, int(push.bias + min(2u * block + uint(h), out_planes - 1u)));
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
  bool halves = live && push.halves != 0u && plane < out_planes && x - x % 2 + 1 < width;
  int to = int(push.out_offset) + image * int(push.out_image) + int(plane * push.out_plane) + x / 2, pitch = int(push.out_pitch);
  [[unroll]] for (int j = 0; j < 4; ++j) {
    int v = PAIRED ? y + j * step : y + 2 * j;
    vec4 others = subgroupShuffle(odd ? means[j][0] : means[j][1], neighbour);
    vec4 mean = 0.25 * ((odd ? means[j][1] : means[j][0]) + others);
    if (halves && v + 1 < height) put(uint(to + v / 2 * pitch), mean);
  }
  int columns = (width + 1) / 2, block_rows = (height + 1) / 2;
  int at = int(push.sums) + (image * (int(out_planes + 1u) / 2) + int(block)) * block_rows * columns + x / 2;
  [[unroll]] for (int j = 0; j < 2; ++j) {
    int pair = odd ? j + 2 : j, v = PAIRED ? y + pair * step : y + 2 * pair;
    vec2 own = odd ? sums[j + 2] : sums[j], other = subgroupShuffle(odd ? sums[j] : sums[j + 2], neighbour);
    vec2 left = odd ? other : own, right = odd ? own : other;
    if (live && v < height) texels[at + v / 2 * columns] = vec4(left.x, right.x, left.y, right.y);
  }
}

void main() {
  push = constants;
  uint item = take_item(push.counter);
  int width = int(push.width), dilation = int(push.dilation), lanes = int(gl_WorkGroupSize.x);
  uint blocks = (push.out_planes + 1u) / 2u, parts = (blocks + push.item_blocks - 1u) / push.item_blocks;
  uint steps = (push.width + gl_WorkGroupSize.x - 1u) / gl_WorkGroupSize.x;
  uint chunks = (steps + push.item_steps - 1u) / push.item_steps;
  // Rows of tiles: with pairs half the phases have one of their own, half as long.
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
    do {
      vec4 acc[T][6][2];
      sums_of(block, in_image + min(x, width - 1), rows, acc);
      if (REDUCED)
        write_reduced(block, acc, image, x, y);
      else if (x < width)
        write_whole(block, acc, image, x, y);
    } while (++block < end_block);
  } while (++step < end);
}
