// A tile of M x M pixels of a plane -> B^T d B, for Winograd F(N x N, 3 x 3). Needs winograd_tile.glsl, the texel buffer
// `activations` and the buffer `transformed_out`.

#include "convolution/winograd_points.glsl"
#define TRANSFORM(m, I) transform(m I(0), m I(1), m I(2), m I(3), m I(4), m I(5));

// Transforms a tile of the plane whose pixel (0, 0) is at `plane`. Position (i, j) goes to texel to + (i M + j) step.
void transform_tile(Tile tile, int plane, int to, int step) {
  int dilation = int(push.dilation), pitch = int(push.in_pitch);
  vec4 m[M][M];
  [[unroll]] for (int j = 0; j < M; ++j) {
    int x = tile.x + (j - 1) * dilation;
    bool column = x >= 0 && x < int(push.width);
    [[unroll]] for (int i = 0; i < M; ++i) {
      int y = tile.y + (i - 1) * dilation;
      bool inside = column && y >= 0 && y < int(push.height);
      // Texel 0 belongs to the border. Other texels beyond the edge may have old contents.
      m[i][j] = texelFetch(activations, inside ? plane + y * pitch + x : 0);
    }
#define ROW(i) [i][j]
    TRANSFORM(m, ROW)
  }
  // A loop that shifts rows instead of code for M rows: code larger than the instruction cache is slow on lavapipe.
  int i = 0;
  do {
#define COLUMN(j) [0][j]
    TRANSFORM(m, COLUMN)
    [[unroll]] for (int j = 0; j < M; ++j) transformed_out[to + j * step] = m[0][j];
    to += M * step;
    [[unroll]] for (int k = 1; k < M; ++k)
      [[unroll]] for (int j = 0; j < M; ++j) m[k - 1][j] = m[k][j];
  } while (++i < M);
}
