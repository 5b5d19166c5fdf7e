#version 460
// Normalisation: raw pixels to (channel - mean) / std, one texel per pixel. With Normalisation::image, the image is first
// normalised to zero mean and unit deviation. A single-channel model uses luma; a grey image has three equal channels.
// Groups: (ceil(width / PIXELS / local size), height, images).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "network/network.h"
layout(local_size_x_id = 0) in;
layout(constant_id = 3) const bool BY_IMAGE = false;
layout(constant_id = 4) const uint PIXELS = 1;  // of an invocation
#include "pixels.glsl"
#define OUT_BINDING 1
#include "network/activations.glsl"
layout(set = 0, binding = 2, std430) readonly buffer Light { vec2 light[]; };  // image_light.comp; not read if not BY_IMAGE
layout(push_constant) uniform Push { NormalisePush push; };

void main() {
  uint lanes = gl_WorkGroupSize.x, v = gl_WorkGroupID.y, image = push.at + gl_WorkGroupID.z;
  uint u = gl_WorkGroupID.x * lanes * PIXELS + gl_LocalInvocationIndex, width = push.width, k = 0u;
  vec3 mean = vec3(push.mean[0], push.mean[1], push.mean[2]);
  vec3 inverse_std = vec3(push.inverse_std[0], push.inverse_std[1], push.inverse_std[2]);
  uint base = (push.first_image + gl_WorkGroupID.z) * push.pixel_stride, row = push.origin + v * push.row_pixels;
  uint to = push.out_offset + image * push.out_image + v * push.out_pitch;
  vec2 of_image = BY_IMAGE ? light[image] : vec2(0.0, 1.0);
  do {
    vec3 c = colour(base, row + min(u, width - 1u));
    if (CHANNELS == 1u) c = vec3(luma(c), 0.0, 0.0);
    if (BY_IMAGE) c = (c - of_image.x) * of_image.y;
    c = (c - mean) * inverse_std;
    if (u < width) put(to + u, CHANNELS == 1u ? vec4(c.x, 0.0, 0.0, 0.0) : vec4(c, 0.0));
    u += lanes;
  } while (++k < PIXELS);
}
