#version 460
// Normalisation: raw pixels -> (channel - mean) / std, one texel a pixel; where the model says so, of an image that has been
// brought to zero mean and unit deviation before. A single-channel model takes luma, a grey image is three equal channels.
// Groups: (ceil(width / local size), height, images).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "network.h"
layout(local_size_x_id = 0) in;
layout(constant_id = 4) const bool BY_IMAGE = false;
#include "pixels.glsl"
#define OUT_BINDING 1
#include "activations.glsl"
layout(set = 0, binding = 2, std430) readonly buffer Light { vec2 light[]; };  // image_light.comp; not read if not BY_IMAGE
layout(push_constant) uniform Push { NormalisePush push; };

void main() {
  uint u = gl_GlobalInvocationID.x, v = gl_WorkGroupID.y, image = gl_WorkGroupID.z;
  if (u >= push.width) return;
  vec3 c = colour((push.first_image + image) * push.pixel_stride, push.origin + v * push.row_pixels + u);
  if (CHANNELS == 1u) c = vec3(luma(c), 0.0, 0.0);
  if (BY_IMAGE) c = (c - light[image].x) * light[image].y;
  vec4 x = vec4((c.x - push.mean[0]) * push.inverse_std[0], 0.0, 0.0, 0.0);
  if (CHANNELS != 1u) {
    x.y = (c.y - push.mean[1]) * push.inverse_std[1];
    x.z = (c.z - push.mean[2]) * push.inverse_std[2];
  }
  put(push.out_offset + image * push.out_image + v * push.out_pitch + u, x);
}
