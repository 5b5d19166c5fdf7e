#version 460
// Grey pyramid, levels 0 to 3 in one pass. An invocation makes an 8x8 block of level 0 and the blocks of the coarser levels
// above it.
// Inputs: raw pixels, rows padded to whole blocks. Outputs: one map per level (align/pyramid.h: grey_pyramid), also for level 0
// unless kernels read the pixels. Padding is undefined.
// Groups: (ceil(blocks_x / local size), blocks_y, images).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint FORMAT = ICLK_FORMAT_RGBA8;
layout(constant_id = 2) const uint LEVELS = 4;

layout(set = 0, binding = 0, std430) readonly buffer Pixels2 { uvec2 pixels2[]; };
layout(set = 0, binding = 0, std430) readonly buffer Pixels4 { uvec4 pixels4[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Maps4 { vec4 maps4[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Maps2 { vec2 maps2[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Maps1 { float maps1[]; };
layout(push_constant) uniform Push { PyramidPush push; };

layout(constant_id = 3) const bool STORE_LEVEL_0 = true;  // false: the pixels have one channel and serve as level 0

float grey(vec3 colour) { return dot(colour, vec3(push.red, push.green, push.blue)); }

float grey8(uint p) {
  vec4 c = unpackUnorm4x8(p);
  return grey(FORMAT == ICLK_FORMAT_BGRA8 ? c.zyx : c.xyz);
}

// Eight pixels of a row, the first at word `w` of the buffer.
void load_row(uint w, out vec4 a, out vec4 b) {
  if (FORMAT == ICLK_FORMAT_R8) {
    uvec2 p = pixels2[w >> 1];
    a = unpackUnorm4x8(p.x);
    b = unpackUnorm4x8(p.y);
  } else if (FORMAT == ICLK_FORMAT_R32F) {
    a = uintBitsToFloat(pixels4[w >> 2]);
    b = uintBitsToFloat(pixels4[(w >> 2) + 1]);
  } else if (FORMAT == ICLK_FORMAT_RGBA32F) {
    uint q = w >> 2;
    a = vec4(grey(uintBitsToFloat(pixels4[q].xyz)), grey(uintBitsToFloat(pixels4[q + 1].xyz)),
             grey(uintBitsToFloat(pixels4[q + 2].xyz)), grey(uintBitsToFloat(pixels4[q + 3].xyz)));
    b = vec4(grey(uintBitsToFloat(pixels4[q + 4].xyz)), grey(uintBitsToFloat(pixels4[q + 5].xyz)),
             grey(uintBitsToFloat(pixels4[q + 6].xyz)), grey(uintBitsToFloat(pixels4[q + 7].xyz)));
  } else {
    uvec4 p = pixels4[w >> 2], q = pixels4[(w >> 2) + 1];
    a = vec4(grey8(p.x), grey8(p.y), grey8(p.z), grey8(p.w));
    b = vec4(grey8(q.x), grey8(q.y), grey8(q.z), grey8(q.w));
  }
}

// Computes a row of level 1 from two rows of level 0.
vec4 halve(vec4 a0, vec4 b0, vec4 a1, vec4 b1) {
  return 0.25 * ((vec4(a0.xz, b0.xz) + vec4(a0.yw, b0.yw)) + (vec4(a1.xz, b1.xz) + vec4(a1.yw, b1.yw)));
}

void main() {
  uint block_x = gl_GlobalInvocationID.x, block_y = gl_WorkGroupID.y;
  if (block_x >= push.blocks_x) return;
  uint image = push.first_image + gl_WorkGroupID.z;
  uint words = FORMAT == ICLK_FORMAT_R8 ? 2u : FORMAT == ICLK_FORMAT_RGBA32F ? 32u : 8u;  // of eight pixels
  uint in_pitch = push.blocks_x * words;
  uint in_base = image * push.pixel_stride + block_x * words;
  uint out_base = image * push.map_stride;
  uint last = push.height - 1u;
  uint y = block_y * ICLK_BLOCK;

  // Pitches of levels 0 to 3 in floats. Not from a buffer: on lavapipe loads are slow and repeated after each store.
  uvec4 pitch = uvec4(push.blocks_x * ICLK_BLOCK) >> uvec4(0u, 1u, 2u, 3u);
  uvec4 height = uvec4(push.height) >> uvec4(0u, 1u, 2u, 3u);
  vec4 one[4];
  uint at0 = out_base + push.offset_0 + block_x * 8u;
#define ROW_PAIR(i)                                                                  \
  {                                                                                  \
    uint v0 = y + 2u * i, v1 = v0 + 1u;                                              \
    vec4 a0, b0, a1, b1;                                                             \
    load_row(in_base + min(v0, last) * in_pitch, a0, b0);                            \
    load_row(in_base + min(v1, last) * in_pitch, a1, b1);                            \
    if (STORE_LEVEL_0 && v0 <= last) {                                                             \
      uint at = (at0 + v0 * pitch[0]) >> 2;                                   \
      maps4[at] = a0;                                                                \
      maps4[at + 1] = b0;                                                            \
    }                                                                                \
    if (STORE_LEVEL_0 && v1 <= last) {                                                             \
      uint at = (at0 + v1 * pitch[0]) >> 2;                                   \
      maps4[at] = a1;                                                                \
      maps4[at + 1] = b1;                                                            \
    }                                                                                \
    one[i] = halve(a0, b0, a1, b1);                                                  \
    uint v = block_y * 4u + i;                                                       \
    if (LEVELS > 1 && v < height[1])                                          \
      maps4[(out_base + push.offset_1 + v * pitch[1] + block_x * 4u) >> 2] = one[i]; \
  }
  ROW_PAIR(0)
  ROW_PAIR(1)
  ROW_PAIR(2)
  ROW_PAIR(3)
  if (LEVELS > 2) {
    vec2 two0 = 0.25 * ((one[0].xz + one[0].yw) + (one[1].xz + one[1].yw));
    vec2 two1 = 0.25 * ((one[2].xz + one[2].yw) + (one[3].xz + one[3].yw));
    uint v = block_y * 2u;
    uint at = out_base + push.offset_2 + v * pitch[2] + block_x * 2u;
    if (v < height[2]) maps2[at >> 1] = two0;
    if (v + 1u < height[2]) maps2[(at + pitch[2]) >> 1] = two1;
    if (LEVELS > 3 && block_y < height[3])
      maps1[out_base + push.offset_3 + block_y * pitch[3] + block_x] =
          0.25 * ((two0.x + two0.y) + (two1.x + two1.y));
  }
}
