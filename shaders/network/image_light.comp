#version 460
// Computes the mean and the inverse standard deviation of an image from the results of image_moments.comp.
// Groups: (images, 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "network/network.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer Moments { vec4 moments[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Light { vec2 light[]; };
shared vec4 parts[gl_WorkGroupSize.x];

// Merges count, mean and sum of squared deviations of two sets (Chan, Golub and LeVeque 1979).
vec4 merged(vec4 a, vec4 b) {
  float n = a.x + b.x;
  if (n == 0.0) return a;
  float d = b.y - a.y, share = b.x / n;
  return vec4(n, a.y + d * share, a.z + b.z + d * d * a.x * share, 0.0);
}

void main() {
  uint lane = gl_LocalInvocationIndex, lanes = gl_WorkGroupSize.x, image = gl_WorkGroupID.x;
  vec4 all = vec4(0.0);
  for (uint strip = 0u; strip < ICLK_LIGHT_STRIPS; ++strip)
    all = merged(all, moments[(image * ICLK_LIGHT_STRIPS + strip) * lanes + lane]);
  parts[lane] = all;
  barrier();
  if (lane != 0u) return;
  for (uint i = 1u; i < lanes; ++i) all = merged(all, parts[i]);
  light[image] = vec2(all.y, 1.0 / max(sqrt(all.z / max(all.x, 1.0)), ICLK_LEAST_DEVIATION));
}
