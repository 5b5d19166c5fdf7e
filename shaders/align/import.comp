#version 460
// Converts an image of the application, with a view of any format, to the raw pixels of the plan.
// Output: rows of the plan's format, padded to whole blocks by repeating the last column.
// Groups: (words of a row / 64, rows, 1). One invocation writes a word of R8 (four pixels), or one pixel.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_samplerless_texture_functions : require
#include "shared.h"
layout(local_size_x = 64) in;
layout(constant_id = 1) const uint FORMAT = ICLK_FORMAT_RGBA8;
layout(set = 0, binding = 0) uniform texture2D view;
layout(set = 0, binding = 1, std430) writeonly buffer Pixels { uint words[]; };
layout(push_constant) uniform Push { ImportPush push; };

vec4 colour_at(uint u) {
  vec4 c = texelFetch(view, ivec2(min(u, push.width - 1u), gl_GlobalInvocationID.y), 0);
  return push.grey != 0u ? vec4(c.xxx, 1.0) : c;
}

float luma_at(uint u) {
  vec4 c = colour_at(u);
  return push.grey != 0u ? c.x : dot(c.xyz, vec3(ICLK_LUMA_R, ICLK_LUMA_G, ICLK_LUMA_B));
}

void main() {
  uint i = gl_GlobalInvocationID.x;
  uint pixels = FORMAT == ICLK_FORMAT_R8 ? 4u : 1u, row = push.row_pixels;
  if (i * pixels >= row) return;
  uint at = push.first_word + gl_GlobalInvocationID.y * (FORMAT == ICLK_FORMAT_R8 ? row / 4u : row) + i;
  if (FORMAT == ICLK_FORMAT_R8) {
    words[at] = packUnorm4x8(vec4(luma_at(4u * i), luma_at(4u * i + 1u), luma_at(4u * i + 2u), luma_at(4u * i + 3u)));
  } else if (FORMAT == ICLK_FORMAT_R32F) {
    words[at] = floatBitsToUint(luma_at(i));
  } else if (FORMAT == ICLK_FORMAT_RGBA32F) {
    uint first = push.first_word + 4u * (gl_GlobalInvocationID.y * row + i);
    uvec4 c = floatBitsToUint(colour_at(i));
    words[first] = c.x;
    words[first + 1u] = c.y;
    words[first + 2u] = c.z;
    words[first + 3u] = c.w;
  } else {
    vec4 c = colour_at(i);
    words[at] = packUnorm4x8(FORMAT == ICLK_FORMAT_BGRA8 ? c.zyxw : c);
  }
}
