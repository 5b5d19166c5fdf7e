// 3x3 convolution, bias and ELU as products of matrices that a subgroup holds together. A workgroup makes a tile of 16 x 8
// pixels, rows `dilation` apart, in CHANNELS output channels: each of four subgroups two rows of 16 pixels. Sixteen channels of
// input at a time lie in shared memory; those of a tap are the matrix pixels x channels, its weights channels x channels.
//
// Matrices are of halves with sums in single precision, so a number x is high + low / 2048 of two halves, 22 bits of it: the
// sums are those of singles but for rounding. Beyond 65504 it is not finite.
//
// Who includes this has the matrices: HALF4 (four halves) from `halves(vec4)`, MATRIX_A, _B, _C, LOAD_A and _B from arrays of
// HALF4, STORE_C, ZERO, MULTIPLY_ADD, JOIN, UNROLL. The device multiplies TM x TK by TK x TN.
// Groups: (CHANNELS output channels each, n, m), n m >= tiles of all images. Lanes: ICLK_MATRIX_SUBGROUPS subgroups.
#include "network/network.h"
layout(local_size_x_id = 0) in;
#include "texels.glsl"
TEXELS(1, vec4, weights)
#define IN_BINDING 0
#define OUT_BINDING 2
#include "network/activations.glsl"
layout(push_constant) uniform Push { ConvPush push; };
layout(constant_id = 1) const int CHANNELS = 2 * ICLK_MATRIX_SIDE;

const int SIDE = ICLK_MATRIX_SIDE, ROWS = ICLK_MATRIX_ROWS, TILE_ROWS = ROWS * ICLK_MATRIX_SUBGROUPS;
const int PATCH_ROWS = TILE_ROWS + 2, MOST_COLUMNS = SIDE + 2 * ICLK_MATRIX_DILATION;
const int BM = SIDE / TM, BN = CHANNELS / TN, BK = SIDE / TK;  // blocks of a tile
const int PLANES = SIDE / 4;
// HALF4 from a pixel of the patch, and a channel of the weights, to the next: rows of matrices lie in other banks of memory.
const int PIXEL = PLANES + 2, CHANNEL = 2 * SIDE / 4 + 2, LINE = SIDE + 4;
const int PATCH = PATCH_ROWS * MOST_COLUMNS * PIXEL, TAPS = 3 * SIDE * CHANNEL;

shared HALF4 patch_high[PATCH], patch_low[PATCH];
shared HALF4 taps_high[TAPS], taps_low[TAPS];
shared float made[ICLK_MATRIX_SUBGROUPS * SIDE * LINE];

// x is this, which a half holds, and low / 2048. To the nearest half, ties to even, by its bits: compilers take a single of a
// half of a single for the first. Below the smallest normal half, which devices may take for zero, it is zero.
vec4 high_part(vec4 x) {
  uvec4 bits = floatBitsToUint(x);
  vec4 nearest = uintBitsToFloat((bits + 0xfffu + ((bits >> 13) & 1u)) & ~0x1fffu);
  return mix(nearest, vec4(0.0), lessThan(abs(x), vec4(6.103515625e-5)));
}

// Sixteen input channels of the tile's taps, from texel `at` on.
void stage_patch(int at, int planes, ivec2 most) {
  int columns = SIDE + 2 * int(push.dilation), count = PLANES * PATCH_ROWS * columns;
  for (int i = int(gl_LocalInvocationIndex); i < count; i += int(gl_WorkGroupSize.x)) {
    int plane = i / (PATCH_ROWS * columns), place = i - plane * PATCH_ROWS * columns;
    int row = place / columns, column = place - row * columns;
    // Behind the last row and column come others' values, or none.
    int v = min(row * int(push.dilation), most.y), u = min(column, most.x);
    int from = at + plane * int(push.in_plane) + v * int(push.in_pitch) + u;
    int to = (row * MOST_COLUMNS + column) * PIXEL + plane;
    vec4 value = plane < planes ? TEXEL(activations, from) : vec4(0.0);
    vec4 high = high_part(value);
    patch_high[to] = halves(high);
    patch_low[to] = halves((value - high) * 2048.0);
  }
}

// The weights of three taps of a column: as `direct` has them, blocks of eight output channels from texel `at` on.
void stage_taps(int at, int planes, int kx, int blocks) {
  int count = 3 * PLANES * CHANNELS;  // texels: of each plane four input channels x CHANNELS / 4
  for (int i = int(gl_LocalInvocationIndex); i < count; i += int(gl_WorkGroupSize.x)) {
    int s = i & 7, block = (i >> 3) % (CHANNELS / 8), rest = (i >> 3) / (CHANNELS / 8);
    int ky = rest % 3, plane = rest / 3;
    bool there = plane < planes && block < blocks;
    int from = at + block * int(push.in_planes) * 72 + (plane * 9 + kx * 3 + ky) * 8 + s;
    int to = (ky * SIDE + 4 * plane + s / 2) * CHANNEL + 2 * block + s % 2;
    vec4 value = there ? TEXEL(weights, from) : vec4(0.0);
    vec4 high = high_part(value);
    taps_high[to] = halves(high);
    taps_low[to] = halves((value - high) * 2048.0);
  }
}

void main() {
  int width = int(push.width), height = int(push.height), dilation = int(push.dilation);
  int tiles = (width + SIDE - 1) / SIDE, span = TILE_ROWS * dilation, row_blocks = (height + span - 1) / span * dilation;
  int tile = int(gl_WorkGroupID.z * gl_NumWorkGroups.y + gl_WorkGroupID.y);
  if (tile >= int(push.images) * row_blocks * tiles) return;  // all of the workgroup
  int x = tile % tiles * SIDE, block = tile / tiles, image = block / row_blocks;
  block -= image * row_blocks;
  int y = block / dilation * span + block % dilation;
  int subgroup = int(gl_SubgroupID), first_row = subgroup * ROWS;
  int first_channel = int(gl_WorkGroupID.x) * CHANNELS;

  int at = int(push.in_offset) + image * int(push.in_image) + y * int(push.in_pitch) + x;
  int taps_at = int(push.weights) + first_channel / 8 * int(push.in_planes) * 72;
  int blocks = (4 * int(push.out_planes) - first_channel + 7) / 8;
  ivec2 most = ivec2(width - 1 - x, height - 1 - y) + 2 * dilation;

  MATRIX_C sums[ROWS * BM * BN], low_sums[ROWS * BM * BN];
  UNROLL for (int i = 0; i < ROWS * BM * BN; ++i) {
    sums[i] = ZERO;
    low_sums[i] = ZERO;
  }
  for (int plane = 0; plane < int(push.in_planes); plane += PLANES) {
    int planes = int(push.in_planes) - plane;
    for (int kx = 0; kx < 3; ++kx) {
      barrier();  // who is past it has multiplied what was there before
      if (kx == 0) stage_patch(at + plane * int(push.in_plane), planes, most);
      stage_taps(taps_at + plane * 72, planes, kx, blocks);
      barrier();
      UNROLL for (int k = 0; k < BK; ++k) {
        MATRIX_A high[(ROWS + 2) * BM], low[(ROWS + 2) * BM];
        UNROLL for (int i = 0; i < (ROWS + 2) * BM; ++i) {
          int from = ((first_row + i / BM) * MOST_COLUMNS + i % BM * TM + kx * dilation) * PIXEL + k * (TK / 4);
          LOAD_A(high[i], patch_high, from, PIXEL);
          LOAD_A(low[i], patch_low, from, PIXEL);
        }
        UNROLL for (int ky = 0; ky < 3; ++ky)
          UNROLL for (int n = 0; n < BN; ++n) {
            int from = (ky * SIDE + k * TK) * CHANNEL + n * (TN / 4);
            MATRIX_B w_high, w_low;
            LOAD_B(w_high, taps_high, from, CHANNEL);
            LOAD_B(w_low, taps_low, from, CHANNEL);
            UNROLL for (int i = 0; i < ROWS * BM; ++i) {
              int j = i * BN + n;
              sums[j] = MULTIPLY_ADD(high[i + ky * BM], w_high, sums[j]);
              low_sums[j] = MULTIPLY_ADD(high[i + ky * BM], w_low, low_sums[j]);
              low_sums[j] = MULTIPLY_ADD(low[i + ky * BM], w_high, low_sums[j]);
            }
          }
      }
    }
  }

  // Sixteen channels of sixteen pixels at a time.
  int mine = subgroup * SIDE * LINE;
  UNROLL for (int r = 0; r < ROWS; ++r)
    UNROLL for (int c = 0; c < CHANNELS / SIDE; ++c) {
      UNROLL for (int m = 0; m < BM; ++m)
        UNROLL for (int n = 0; n < SIDE / TN; ++n) {
          int j = (r * BM + m) * BN + c * (SIDE / TN) + n;
          STORE_C(JOIN(sums[j], low_sums[j], 1.0 / 2048.0), made, mine + m * TM * LINE + n * TN, LINE);
        }
      subgroupMemoryBarrierShared();
      subgroupBarrier();
      int v = y + (first_row + r) * dilation;
      for (int i = int(gl_SubgroupInvocationID); i < SIDE * PLANES; i += int(gl_SubgroupSize)) {
        int column = i % SIDE, plane = (first_channel + c * SIDE) / 4 + i / SIDE, from = mine + column * LINE + i / SIDE * 4;
        if (v >= height || x + column >= width || plane >= int(push.out_planes)) continue;
        vec4 sum = vec4(made[from], made[from + 1], made[from + 2], made[from + 3]);
        put(push.out_offset + uint(image) * push.out_image + uint(plane) * push.out_plane + uint(v) * push.out_pitch +
                uint(x + column),
            elu(sum + TEXEL(weights, int(push.bias) + plane)));
      }
      subgroupMemoryBarrierShared();
      subgroupBarrier();
    }
}
