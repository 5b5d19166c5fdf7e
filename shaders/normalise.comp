#version 460
// Colour normalisation: raw pixels -> (channel - mean) / std, one texel a pixel; a single-channel model takes luma, a grey
// image is three equal channels. Groups: (ceil(width / local size), height, images).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "network.h"
layout(local_size_x_id = 0) in;
layout(constant_id = 2) const uint FORMAT = ICLK_FORMAT_RGBA8;
layout(constant_id = 3) const uint CHANNELS = 3;
layout(set = 0, binding = 0, std430) readonly buffer Pixels { uint pixels[]; };
#define OUT_BINDING 1
#include "activations.glsl"
layout(push_constant) uniform Push { NormalisePush push; };

const vec3 LUMA = vec3(0.299, 0.587, 0.114);

vec3 colour(uint base, uint pixel) {
  if (FORMAT == ICLK_FORMAT_R8) return vec3(float((pixels[base + pixel / 4u] >> (8u * (pixel % 4u))) & 255u) / 255.0);
  if (FORMAT == ICLK_FORMAT_R32F) return vec3(uintBitsToFloat(pixels[base + pixel]));
  if (FORMAT == ICLK_FORMAT_RGBA32F) {
    uint at = base + 4u * pixel;
    return uintBitsToFloat(uvec3(pixels[at], pixels[at + 1u], pixels[at + 2u]));
  }
  vec4 c = unpackUnorm4x8(pixels[base + pixel]);
  return FORMAT == ICLK_FORMAT_BGRA8 ? c.zyx : c.xyz;
}

void main() {
  uint u = gl_GlobalInvocationID.x, v = gl_WorkGroupID.y, image = gl_WorkGroupID.z;
  if (u >= push.width) return;
  vec3 c = colour((push.first_image + image) * push.pixel_stride, push.origin + v * push.row_pixels + u);
  bool grey = FORMAT == ICLK_FORMAT_R8 || FORMAT == ICLK_FORMAT_R32F;
  vec4 x;
  if (CHANNELS == 1u) {
    float luma = grey ? c.x : dot(c, LUMA);
    x = vec4((luma - push.mean[0]) * push.inverse_std[0], 0.0, 0.0, 0.0);
  } else {
    x = vec4((c.x - push.mean[0]) * push.inverse_std[0], (c.y - push.mean[1]) * push.inverse_std[1],
             (c.z - push.mean[2]) * push.inverse_std[2], 0.0);
  }
  put(push.out_offset + image * push.out_image + v * push.out_pitch + u, x);
}
