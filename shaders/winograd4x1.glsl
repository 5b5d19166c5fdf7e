// 3x3 convolution, bias and ELU by Winograd F(4, 3) along columns: half the products of conv_direct.glsl, and as there nothing
// between input and output goes through memory. An invocation makes eight output channels of ICLK_COLUMN_TILES tiles of four
// pixels of a column, `dilation` apart.
#extension GL_GOOGLE_include_directive : require
#include "conv_column.glsl"
#include "winograd_points.glsl"

#define T ICLK_COLUMN_TILES
#define R (4 * T)

void main() {
  Column column = column_of(R);
  int image = column.image, x = column.x, y = column.y;
  int height = int(push.height), dilation = int(push.dilation);

  // Every row counts for all rows of its tile, if only by what rounding leaves of it: those below the border are the border's.
  int rows[R + 2];
  [[unroll]] for (int r = 0; r < R + 2; ++r) rows[r] = min(y + r * dilation, height + dilation) * int(push.in_pitch);
  int at = int(push.in_offset) + image * int(push.in_image) + x;
  int w = int(push.weights + gl_WorkGroupID.x * push.in_planes * 144u);
  vec4 acc[T][6][2];
  [[unroll]] for (int t = 0; t < T; ++t)
    [[unroll]] for (int p = 0; p < 6; ++p) acc[t][p][0] = acc[t][p][1] = vec4(0.0);
  uint c = 0u;
  do {
    int kx = 0;
    do {
      vec4 v[R + 2], d[T][6];
      [[unroll]] for (int r = 0; r < R + 2; ++r) v[r] = texelFetch(activations, at + kx * dilation + rows[r]);
      [[unroll]] for (int t = 0; t < T; ++t) {
        [[unroll]] for (int p = 0; p < 6; ++p) d[t][p] = v[4 * t + p];
        transform(d[t][0], d[t][1], d[t][2], d[t][3], d[t][4], d[t][5]);
      }
      // One output channel at a time: its four weights and the sums of its tiles stay in registers.
      [[unroll]] for (int p = 0; p < 6; ++p) {
        LOAD_WEIGHTS(own, w)
        [[unroll]] for (int h = 0; h < 2; ++h)
          [[unroll]] for (int o = 0; o < 4; ++o) {
            float g[4];
            [[unroll]] for (int q = 0; q < 4; ++q) g[q] = WEIGHT(own, w, 2 * q + h)[o];
            [[unroll]] for (int t = 0; t < T; ++t)
              [[unroll]] for (int q = 0; q < 4; ++q) acc[t][p][h][o] += d[t][p][q] * g[q];
          }
        w += 8;
      }
    } while (++kx < 3);
    at += int(push.in_plane);
  } while (++c < push.in_planes);
  if (!column.live) return;
  int out_at = int(push.out_offset) + image * int(push.out_image) + x;
  [[unroll]] for (int h = 0; h < 2; ++h) {
    uint plane = 2u * gl_WorkGroupID.x + uint(h);
    if (plane >= push.out_planes) return;
    vec4 bias = texelFetch(weights, int(push.bias + plane));
    [[unroll]] for (int t = 0; t < T; ++t) {
      vec4 even_a = acc[t][1][h] + acc[t][2][h], odd_a = A * (acc[t][1][h] - acc[t][2][h]);
      vec4 even_b = acc[t][3][h] + acc[t][4][h], odd_b = B * (acc[t][3][h] - acc[t][4][h]);
      vec4 value[4] = vec4[4](acc[t][0][h] + even_a + even_b, odd_a + odd_b, A2 * even_a + B2 * even_b,
                              A2 * odd_a + B2 * odd_b + acc[t][5][h]);
      [[unroll]] for (int r = 0; r < 4; ++r) {
        int v = y + (4 * t + r) * dilation;
        if (v < height) put(uint(out_at + int(plane * push.out_plane) + v * int(push.out_pitch)), elu(value[r] + bias));
      }
    }
  }
}
