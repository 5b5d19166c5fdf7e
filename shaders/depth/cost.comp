#version 460
// Matching cost of every pixel and plane: Hamming distance of census signatures, of several views the mean of the better half,
// so that who is hidden in some is judged by the others. A prior adds its own cost.
// Groups: (ceil(width height / local size), 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
#include "depth/words.glsl"
#include "texels.glsl"
WORDS_OF(0, census)
TEXELS(1, float, priors)
layout(set = 0, binding = 2, std140) uniform Views { DepthViews views; };
layout(set = 0, binding = 3, std430) writeonly buffer Volume { uint volume[]; };
layout(push_constant) uniform Push { DepthPush push; };
#include "depth/project.glsl"

uint distance_to(uint own, int base, int pixel) {
  return pixel < 0 ? ICLK_DEPTH_OUTSIDE : uint(bitCount(own ^ WORD(census, base + pixel)));
}

void main() {
  uint k = gl_GlobalInvocationID.x, area = push.width * push.height;
  if (k >= area) return;
  vec2 uv = vec2(k % push.width, k / push.width);
  uint own = WORD(census, int(k)), half_of_views = (push.views + 1u) / 2u;
  float prior = TEXEL(priors, int(k)).x;
  vec3 h[ICLK_DEPTH_VIEWS];
  for (uint view = 0u; view < push.views; ++view) h[view] = ray_in(view, uv);
  for (uint word = 0u; word < push.words; ++word) {
    vec4 planes = vec4(4u * word) + vec4(0, 1, 2, 3);
    precise vec4 w = push.first + push.step * planes;
    uvec4 b0 = uvec4(255u), b1 = b0, b2 = b0, b3 = b0;  // the four least, in order
    for (uint view = 0u; view < push.views; ++view) {
      vec3 e = epipole_of(view);
      int base = int((view + 1u) * area);
      uvec4 c;
      c.x = distance_to(own, base, pixel_in(h[view], e, w.x));
      c.y = distance_to(own, base, pixel_in(h[view], e, w.y));
      c.z = distance_to(own, base, pixel_in(h[view], e, w.z));
      c.w = distance_to(own, base, pixel_in(h[view], e, w.w));
      uvec4 more = max(b0, c);
      b0 = min(b0, c);
      c = max(b1, more), b1 = min(b1, more);
      more = max(b2, c), b2 = min(b2, c);
      b3 = min(b3, more);
    }
    uvec4 sum = b0;
    if (half_of_views > 1u) sum += b1;
    if (half_of_views > 2u) sum += b2;
    if (half_of_views > 3u) sum += b3;
    sum /= half_of_views;
    if (prior >= 0.0) {
      vec4 away = min(ICLK_DEPTH_PRIOR_SLOPE * abs(planes - prior), float(ICLK_CENSUS_BITS));
      sum = (sum + 3u * uvec4(away)) / 4u;
    }
    volume[k * push.words + word] = pack(sum);
  }
}
