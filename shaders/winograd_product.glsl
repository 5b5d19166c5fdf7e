// Winograd F(N x N, 3 x 3), second part: products over the input channels for each of the (N + 2)^2 positions, summed into
// A^T m A on the way, bias and ELU. An invocation makes eight output channels of ICLK_WINOGRAD_TILES tiles.
// Groups: (blocks of eight output channels, ceil(tiles / ICLK_WINOGRAD_TILES / local size), 1).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "network.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0) uniform samplerBuffer transformed;
layout(set = 0, binding = 1) uniform samplerBuffer weights;
#define OUT_BINDING 2
#include "activations.glsl"
layout(push_constant) uniform Push { WinogradPush push; };
#include "conv_weights.glsl"
#include "winograd_tile.glsl"

#define M (N + 2)
#define T ICLK_WINOGRAD_TILES

// Column i of A^T: powers of the points 0, A, -A, B, -B and infinity; of F(2 x 2): 0, 1, -1 and infinity.
vec4 powers(int i) {
#if N == 4
  const float A = ICLK_WINOGRAD_A, B = ICLK_WINOGRAD_B;
  float x = i == 1 ? A : i == 2 ? -A : i == 3 ? B : i == 4 ? -B : 0.0;
  return i == 5 ? vec4(0.0, 0.0, 0.0, 1.0) : vec4(1.0, x, x * x, x * x * x);
#else
  float x = i == 1 ? 1.0 : i == 2 ? -1.0 : 0.0;
  return i == 3 ? vec4(0.0, -1.0, 0.0, 0.0) : vec4(1.0, x, 0.0, 0.0);
#endif
}

void main() {
  int lanes = int(gl_WorkGroupSize.x);
  int first = int(gl_WorkGroupID.y) * lanes * T + int(gl_LocalInvocationIndex);
  int strip = int(push.strip), at = first;
  int w = int(push.weights + gl_WorkGroupID.x * (M * M) * push.in_planes * 8u);
  vec4 sum[N][N][T][2];
  [[unroll]] for (int a = 0; a < N; ++a)
    [[unroll]] for (int b = 0; b < N; ++b)
      [[unroll]] for (int t = 0; t < T; ++t) sum[a][b][t][0] = sum[a][b][t][1] = vec4(0.0);
  for (int i = 0; i < M; ++i) {
    vec4 row[N][T][2];
    [[unroll]] for (int b = 0; b < N; ++b)
      [[unroll]] for (int t = 0; t < T; ++t) row[b][t][0] = row[b][t][1] = vec4(0.0);
    for (int j = 0; j < M; ++j) {
      vec4 acc[T][2];
      [[unroll]] for (int t = 0; t < T; ++t) acc[t][0] = acc[t][1] = vec4(0.0);
      for (uint c = 0u; c < push.in_planes; ++c) {
        LOAD_WEIGHTS(own, w)
        vec4 v[T];
        [[unroll]] for (int t = 0; t < T; ++t) v[t] = texelFetch(transformed, at + t * lanes);
        [[unroll]] for (int q = 0; q < 4; ++q) {
          vec4 lo = WEIGHT(own, w, 2 * q), hi = WEIGHT(own, w, 2 * q + 1);
          [[unroll]] for (int t = 0; t < T; ++t) {
            acc[t][0] += v[t][q] * lo;
            acc[t][1] += v[t][q] * hi;
          }
        }
        at += strip;
        w += 8;
      }
      vec4 p = powers(j);
      [[unroll]] for (int b = 0; b < N; ++b)
        [[unroll]] for (int t = 0; t < T; ++t) {
          row[b][t][0] += p[b] * acc[t][0];
          row[b][t][1] += p[b] * acc[t][1];
        }
    }
    vec4 p = powers(i);
    [[unroll]] for (int a = 0; a < N; ++a)
      [[unroll]] for (int b = 0; b < N; ++b)
        [[unroll]] for (int t = 0; t < T; ++t) {
          sum[a][b][t][0] += p[a] * row[b][t][0];
          sum[a][b][t][1] += p[a] * row[b][t][1];
        }
  }
  int dilation = int(push.dilation);
  [[unroll]] for (int t = 0; t < T; ++t) {
    int index = first + t * lanes;
    bool live = index < int(push.tiles);
    Tile tile = tile_at(int(push.first_tile) + min(index, int(push.tiles) - 1));
    int out_at = int(push.out_offset) + tile.image * int(push.out_image);
    [[unroll]] for (int h = 0; h < 2; ++h) {
      uint plane = 2u * gl_WorkGroupID.x + uint(h);
      bool exists = live && plane < push.out_planes;
      vec4 bias = texelFetch(weights, int(push.bias + min(plane, push.out_planes - 1u)));
      [[unroll]] for (int a = 0; a < N; ++a)
        [[unroll]] for (int b = 0; b < N; ++b) {
          int x = tile.x + b * dilation, y = tile.y + a * dilation;
          vec4 value = elu(sum[a][b][t][h] + bias);
          if (exists && x < int(push.width) && y < int(push.height))
            put(uint(out_at + int(plane * push.out_plane) + y * int(push.out_pitch) + x), value);
        }
    }
  }
}
