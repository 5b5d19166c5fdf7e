// Winograd F(4, 3) along columns in registers: the sums of eight output channels of ICLK_COLUMN_TILES tiles of four pixels of a
// column, `dilation` apart. It has half the products of conv_direct.glsl, and also no memory traffic between input and output.
#include "convolution/winograd_points.glsl"

#define T ICLK_COLUMN_TILES
// The number of input rows; adjacent tiles share some.
#define R (PAIRED ? 6 * T : 4 * T + 2)

// The addresses of input rows; the first one is that of the tap above `y`. By rounding, every row affects all rows of its tile.
// Rows below the border are therefore replaced by the border.
void find_rows(int y, out int rows[6 * T]) {
  int dilation = int(push.dilation), last = int(push.height) + dilation, pitch = int(push.in_pitch);
  [[unroll]] for (int r = 0; r < R; ++r)
    rows[r] = min(PAIRED ? y + r / 6 + r % 6 * dilation : y + r * dilation, last) * pitch;
}

// `at`: the address of the left taps in the first row of plane 0.
void sums_of(uint block, int at, int rows[6 * T], out vec4 acc[T][6][2]) {
  int dilation = int(push.dilation), in_plane = int(push.in_plane);
  uint planes = push.in_planes;
  int w = int(push.weights + block * planes * 144u);
  [[unroll]] for (int t = 0; t < T; ++t)
    [[unroll]] for (int p = 0; p < 6; ++p) acc[t][p][0] = acc[t][p][1] = vec4(0.0);
  uint c = 0u;
  do {
    int kx = 0;
    do {
      vec4 v[6 * T], d[T][6];
      [[unroll]] for (int r = 0; r < R; ++r) v[r] = TEXEL(activations, at + kx * dilation + rows[r]);
      [[unroll]] for (int t = 0; t < T; ++t) {
        [[unroll]] for (int p = 0; p < 6; ++p) d[t][p] = v[(PAIRED ? 6 : 4) * t + p];
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
    at += in_plane;
  } while (++c < planes);
}

// The four pixels of a tile, before bias and ELU.
vec4[4] pixels_of(vec4 acc[6][2], int h) {
  vec4 even_a = acc[1][h] + acc[2][h], odd_a = A * (acc[1][h] - acc[2][h]);
  vec4 even_b = acc[3][h] + acc[4][h], odd_b = B * (acc[3][h] - acc[4][h]);
  return vec4[4](acc[0][h] + even_a + even_b, odd_a + odd_b, A2 * even_a + B2 * even_b,
                 A2 * odd_a + B2 * odd_b + acc[5][h]);
}

void write_whole(uint block, vec4 acc[T][6][2], int image, int x, int y) {
  int height = int(push.height), dilation = int(push.dilation);
  int out_at = int(push.out_offset) + image * int(push.out_image) + x;
  [[unroll]] for (int h = 0; h < 2; ++h) {
    uint plane = 2u * block + uint(h);
    if (plane >= push.out_planes) return;
    vec4 bias = TEXEL(weights, int(push.bias + plane));
    [[unroll]] for (int t = 0; t < T; ++t) {
      vec4 value[4] = pixels_of(acc[t], h);
      [[unroll]] for (int r = 0; r < 4; ++r) {
        int v = y + (4 * t + r) * dilation;
        if (v < height) put(uint(out_at + int(plane * push.out_plane) + v * int(push.out_pitch)), elu(value[r] + bias));
      }
    }
  }
}
