// 3x3 convolution, bias and ELU with a register tile: an invocation computes eight output channels, or ONE, of R pixels of a
// column, `dilation` apart.
#extension GL_GOOGLE_include_directive : require
#include "convolution/conv_column.glsl"
#ifdef PATCHES
layout(set = 0, binding = 3, std430) readonly buffer Corners { ivec2 corners[]; };
#endif

layout(constant_id = 1) const int R = ICLK_CONV_ROWS;
layout(constant_id = 2) const bool ONE = false;

void main() {
  Column column = column_of(R);
  int image = column.image, x = column.x, y = column.y;
  int height = int(push.height), dilation = int(push.dilation);

  int pitch = int(push.in_pitch), step = dilation * pitch;
  int at = int(push.in_offset) + image * int(push.in_image) + y * pitch + x;
  int w = int(push.weights + gl_WorkGroupID.x * push.in_planes * 72u);
  vec4 acc[ICLK_CONV_MOST_ROWS][2];
  [[unroll]] for (int r = 0; r < R; ++r) acc[r][0] = acc[r][1] = vec4(0.0);
  uint c = 0u;
#ifdef SHARED
  ask_weights(w);
#endif
  do {
#ifdef SHARED
    keep_weights(w);
    if (c + 1u < push.in_planes) ask_weights(w + ICLK_PLANE_WEIGHTS);
#endif
    int kx = 0;
    do {
      vec4 v[ICLK_CONV_MOST_ROWS + 2];
      [[unroll]] for (int r = 0; r < R + 2; ++r) v[r] = TEXEL(activations, at + kx * dilation + r * step);
      vec4 lo[3][4], hi[3][4];
      [[unroll]] for (int ky = 0; ky < 3; ++ky) {
        int block_at = w + (kx * 3 + ky) * 8;
        LOAD_WEIGHTS(own, block_at)
        [[unroll]] for (int q = 0; q < 4; ++q) {
          lo[ky][q] = WEIGHT(own, block_at, 2 * q);
          hi[ky][q] = WEIGHT(own, block_at, 2 * q + 1);
        }
      }
      [[unroll]] for (int r = 0; r < R; ++r) {
        if (ONE) {
          [[unroll]] for (int ky = 0; ky < 3; ++ky)
            [[unroll]] for (int q = 0; q < 4; ++q) acc[r][0].x += v[r + ky][q] * lo[ky][q].x;
          continue;
        }
        [[unroll]] for (int ky = 0; ky < 3; ++ky)
          [[unroll]] for (int q = 0; q < 4; ++q) acc[r][0] += v[r + ky][q] * lo[ky][q];
        [[unroll]] for (int ky = 0; ky < 3; ++ky)
          [[unroll]] for (int q = 0; q < 4; ++q) acc[r][1] += v[r + ky][q] * hi[ky][q];
      }
    } while (++kx < 3);
    at += int(push.in_plane);
    w += 72;
  } while (++c < push.in_planes);
  if (!column.live) return;
  int out_at = int(push.out_offset) + image * int(push.out_image) + x;
#ifdef PATCHES
  ivec2 first = corners[image] - int(push.margin) + ivec2(x, 0);
  bool in_level = first.x >= 0 && first.x < int(push.level_width);
#endif
  [[unroll]] for (int h = 0; h < 2; ++h) {
    uint plane = 2u * gl_WorkGroupID.x + uint(h);
    if (plane >= push.out_planes) return;
    vec4 bias = TEXEL(weights, int(push.bias + plane));
    [[unroll]] for (int r = 0; r < R; ++r) {
      int v = y + r * dilation;
      vec4 value = elu(acc[r][h] + bias);
#ifdef PATCHES
      if (!in_level || first.y + v < 0 || first.y + v >= int(push.level_height)) value = vec4(0.0);
#endif
      if (v < height) put(uint(out_at + int(plane * push.out_plane) + v * int(push.out_pitch)), value);
    }
  }
}
