// Winograd F(N x N, 3 x 3), first part: a tile of (N + 2)^2 pixels of one plane -> B^T d B, for the tiles of a strip. Dilation
// makes interleaved sub-grids with tiles of their own. Output [position][plane][tile].
// Groups: (ceil(tiles / local size), input planes, 1).
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "network.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0) uniform samplerBuffer activations;
layout(set = 0, binding = 1, std430) writeonly buffer Out { vec4 transformed[]; };
layout(push_constant) uniform Push { WinogradPush push; };
#include "winograd_tile.glsl"

#define M (N + 2)

#if N == 4
#include "winograd_points.glsl"
#define TRANSFORM(m, I) transform(m I(0), m I(1), m I(2), m I(3), m I(4), m I(5));
#elif N == 6
#include "winograd6_points.glsl"
#define TRANSFORM(m, I) transform(m I(0), m I(1), m I(2), m I(3), m I(4), m I(5), m I(6), m I(7));
#else
void transform(inout vec4 a, inout vec4 b, inout vec4 c, inout vec4 d) {
  vec4 p = b + c;
  a = c - a;
  d -= b;
  c -= b;
  b = p;
}
#define TRANSFORM(m, I) transform(m I(0), m I(1), m I(2), m I(3));
#endif

void main() {
  uint t = gl_GlobalInvocationID.x, c = gl_WorkGroupID.y;
  if (t >= push.tiles) return;
  Tile tile = tile_at(int(push.first_tile + t));
  if (tile.image >= int(push.images)) return;
  int dilation = int(push.dilation), pitch = int(push.in_pitch);
  int base = int(push.in_offset + c * push.in_plane) + tile.image * int(push.in_image);
  vec4 m[M][M];
  [[unroll]] for (int j = 0; j < M; ++j) {
    int x = tile.x + (j - 1) * dilation;
    bool column = x >= 0 && x < int(push.width);
    [[unroll]] for (int i = 0; i < M; ++i) {
      int y = tile.y + (i - 1) * dilation;
      bool inside = column && y >= 0 && y < int(push.height);
      // Texel 0 is of the border. What else a tile at the edge would read depends on what lay there before.
      m[i][j] = texelFetch(activations, inside ? base + y * pitch + x : 0);
    }
#define ROW(i) [i][j]
    TRANSFORM(m, ROW)
  }
  // A loop whose rows move up, not M rows of code: what does not fit a core's instruction cache is slow on lavapipe.
  int to = int(c * push.strip + t), step = int(push.in_planes * push.strip), i = 0;
  do {
#define COLUMN(j) [0][j]
    TRANSFORM(m, COLUMN)
    [[unroll]] for (int j = 0; j < M; ++j) transformed[to + j * step] = m[0][j];
    to += M * step;
    [[unroll]] for (int k = 1; k < M; ++k)
      [[unroll]] for (int j = 0; j < M; ++j) m[k - 1][j] = m[k][j];
  } while (++i < M);
}
