// Winograd F(N x N, 3 x 3) after the transform: products over the input channels for each of the (N + 2)^2 positions, sums of
// A^T m A, bias and ELU. An invocation computes eight output channels of ICLK_WINOGRAD_TILES tiles. Needs winograd_tile.glsl
// and the storage texel buffers `transformed` and `weights`; output goes to binding 2.
//
// REDUCED, for a level's last layer with an even dilation: instead of the output it writes smaller results. These are 2x2 means
// of each channel for the next level, and sums over eight channels for the map (feature_sums.comp).
layout(constant_id = 1) const bool REDUCED = false;
#define FETCH imageLoad
#define OUT_BINDING 2
#include "network/activations.glsl"
#include "convolution/conv_weights.glsl"

#define T ICLK_WINOGRAD_TILES

// The points at which polynomials are multiplied, between 0 and infinity: pairs of a sign each.
const float POINTS[2] = float[2](ICLK_WINOGRAD_A, ICLK_WINOGRAD_B);

// Column i of A^T: powers of a point.
void powers(int i, out float p[N]) {
  float x = 0.0;
  [[unroll]] for (int k = 0; k < N / 2; ++k) x = i == 2 * k + 1 ? POINTS[k] : i == 2 * k + 2 ? -POINTS[k] : x;
  p[0] = i == M - 1 ? 0.0 : 1.0;
  [[unroll]] for (int k = 1; k < N; ++k) p[k] = p[k - 1] * x;
  if (i == M - 1) p[N - 1] = 1.0;
}

// Sums over the input channels at one position. Its transformed tiles begin at `at` and its weights at `w`; both are advanced
// to the next position. `strip`: tiles of a plane. It processes two planes at a time, so that a sum stays in its register for
// eight products. For an odd number of planes the last one is used twice, the second time with zero weights.
void product(int strip, inout int at, inout int w, out vec4 acc[T][2]) {
  int lanes = int(gl_WorkGroupSize.x);
  [[unroll]] for (int t = 0; t < T; ++t) acc[t][0] = acc[t][1] = vec4(0.0);
  uint c = 0u;
  do {
    vec4 v[2][T], lo[2][4], hi[2][4];
    [[unroll]] for (int u = 0; u < 2; ++u) {
      LOAD_WEIGHTS(own, w)
      [[unroll]] for (int t = 0; t < T; ++t) v[u][t] = imageLoad(transformed, at + t * lanes);
      [[unroll]] for (int q = 0; q < 4; ++q) {
        lo[u][q] = WEIGHT(own, w, 2 * q);
        hi[u][q] = WEIGHT(own, w, 2 * q + 1);
      }
      c += 1u;
      if (c < push.in_planes) at += strip;
      w += 8;
    }
    [[unroll]] for (int t = 0; t < T; ++t) {
      [[unroll]] for (int u = 0; u < 2; ++u)
        [[unroll]] for (int q = 0; q < 4; ++q) acc[t][0] += v[u][t][q] * lo[u][q];
      [[unroll]] for (int u = 0; u < 2; ++u)
        [[unroll]] for (int q = 0; q < 4; ++q) acc[t][1] += v[u][t][q] * hi[u][q];
    }
  } while (c < push.in_planes);
  at += strip;
}

// Adds two positions of a row at points x and -x: even powers use their sum, odd ones their difference.
void add_pair(float x, vec4 plus[T][2], vec4 minus[T][2], inout vec4 row[N][T][2]) {
  [[unroll]] for (int t = 0; t < T; ++t)
    [[unroll]] for (int h = 0; h < 2; ++h) {
      vec4 even = plus[t][h] + minus[t][h], odd = plus[t][h] - minus[t][h];
      float power = 1.0;
      [[unroll]] for (int k = 0; k < N; ++k) {
        row[k][t][h] += power * (k % 2 == 0 ? even : odd);
        power *= x;
      }
    }
}

uint blocks() { return (push.out_planes + 1u) / 2u; }  // of eight output channels

// A^T m A of block `block`, for the transformed tiles that begin at `at`.
void sums_of_block(uint block, int strip, int at, out vec4 sum[N][N][T][2]) {
  int w = int(push.weights + block * (M * M) * ((push.in_planes + 1u) / 2u) * 16u);
  [[unroll]] for (int a = 0; a < N; ++a)
    [[unroll]] for (int b = 0; b < N; ++b)
      [[unroll]] for (int t = 0; t < T; ++t) sum[a][b][t][0] = sum[a][b][t][1] = vec4(0.0);
  int i = 0;
  do {
    vec4 row[N][T][2], m[T][2], n[T][2];
    product(strip, at, w, row[0]);
    [[unroll]] for (int b = 1; b < N; ++b)
      [[unroll]] for (int t = 0; t < T; ++t) row[b][t][0] = row[b][t][1] = vec4(0.0);
    // Written out: Mesa does not unroll a loop around another.
#define PAIR(k) \
  product(strip, at, w, m); \
  product(strip, at, w, n); \
  add_pair(POINTS[k], m, n, row);
    PAIR(0)
    PAIR(1)
    product(strip, at, w, m);
    [[unroll]] for (int t = 0; t < T; ++t)
      [[unroll]] for (int h = 0; h < 2; ++h) row[N - 1][t][h] += m[t][h];
    float p[N];
    powers(i, p);
    [[unroll]] for (int a = 0; a < N; ++a)
      [[unroll]] for (int b = 0; b < N; ++b)
        [[unroll]] for (int t = 0; t < T; ++t) {
          sum[a][b][t][0] += p[a] * row[b][t][0];
          sum[a][b][t][1] += p[a] * row[b][t][1];
        }
  } while (++i < M);
}

// `first`: the index in the strip of the invocation's first tile; the others follow at distances of a workgroup's lanes.
void write_reduced(uint block, int first, inout vec4 sum[N][N][T][2]) {
  int dilation = int(push.dilation), width = int(push.width), height = int(push.height), pitch = int(push.out_pitch);
  int out_plane = int(push.out_plane);
  int tiles = int(push.tiles), out_offset = int(push.out_offset) + int(2u * block) * out_plane;
  // The tiles are those of four sub-grids: the same pixel of each makes a 2x2 block.
  Tile tile = tile_at(min(first, tiles - 1));
  bool live = first < tiles && tile.image < int(push.images), halves = live && push.halves != 0u;
  int columns = (width + 1) / 2, rows = (height + 1) / 2;
  int to = out_offset + tile.image * int(push.out_image) + tile.y / 2 * pitch + tile.x / 2;
  int image = tile.image * int(blocks()) + int(block);
  int sums = int(push.sums) + (image * rows + tile.y / 2) * columns + tile.x / 2;
  vec4 bias[2] = vec4[2](imageLoad(weights, int(push.bias + 2u * block)),
                         imageLoad(weights, int(push.bias + 2u * block + 1u)));
  int a = 0;
  do {
    [[unroll]] for (int b = 0; b < N; ++b) {
      int x = tile.x + b * dilation;
      vec4 channels = vec4(0.0);
      [[unroll]] for (int h = 0; h < 2; ++h) {
        vec4 four = vec4(0.0);
        [[unroll]] for (int t = 0; t < T; ++t) {
          vec4 value = elu(sum[0][b][t][h] + bias[h]);
          four += value;
          channels[t] += (value.x + value.y) + (value.z + value.w);
        }
        bool exists = halves && 2u * block + uint(h) < push.out_planes;
        if (exists && x + 1 < width && tile.y + 1 < height) put(uint(to + h * out_plane + b * dilation / 2), 0.25 * four);
      }
      if (live && x < width && tile.y < height) texels[sums + b * dilation / 2] = channels;
    }
    tile.y += dilation;
    to += dilation / 2 * pitch;
    sums += dilation / 2 * columns;
    [[unroll]] for (int k = 1; k < N; ++k)
      [[unroll]] for (int b = 0; b < N; ++b)
        [[unroll]] for (int t = 0; t < T; ++t)
          [[unroll]] for (int h = 0; h < 2; ++h) sum[k - 1][b][t][h] = sum[k][b][t][h];
  } while (++a < N);
}

void write_whole(uint block, int first, inout vec4 sum[N][N][T][2]) {
  int dilation = int(push.dilation), width = int(push.width), height = int(push.height), pitch = int(push.out_pitch);
  int out_plane = int(push.out_plane);
  int lanes = int(gl_WorkGroupSize.x), tiles = int(push.tiles), out_offset = int(push.out_offset) + int(2u * block) * out_plane;
  int t = 0;
  do {
    int index = first + t * lanes;
    Tile tile = tile_at(min(index, tiles - 1));
    bool live = index < tiles && tile.image < int(push.images);
    int out_at = out_offset + tile.image * int(push.out_image) + tile.y * pitch + tile.x;
    [[unroll]] for (int h = 0; h < 2; ++h) {
      uint plane = 2u * block + uint(h);
      bool exists = live && plane < push.out_planes;
      vec4 bias = imageLoad(weights, int(push.bias + min(plane, push.out_planes - 1u)));
      [[unroll]] for (int a = 0; a < N; ++a) {
        bool row = exists && tile.y + a * dilation < height;
        [[unroll]] for (int b = 0; b < N; ++b) {
          vec4 value = elu(sum[a][b][0][h] + bias);
          int to = out_at + a * dilation * pitch + b * dilation;
          if (row && tile.x + b * dilation < width) put(uint(to), value);
        }
      }
      out_at += out_plane;
    }
    [[unroll]] for (int a = 0; a < N; ++a)
      [[unroll]] for (int b = 0; b < N; ++b)
        [[unroll]] for (int k = 1; k < T; ++k)
          [[unroll]] for (int h = 0; h < 2; ++h) sum[a][b][k - 1][h] = sum[a][b][k][h];
  } while (++t < T);
}

// `at`, `first`: see above.
void multiply(uint block, int strip, int at, int first) {
  vec4 sum[N][N][T][2];
  sums_of_block(block, strip, at, sum);
  if (REDUCED)
    write_reduced(block, first, sum);
  else
    write_whole(block, first, sum);
}
