#version 460
// The matching cost of every pixel and plane: the Hamming distance of census signatures. Of several views it is the mean of the
// better half, so that views in which the pixel is hidden do not count. A prior adds a cost.
// Groups: (ceil(width rows / local size), 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint QUADS = 8;
layout(constant_id = 2) const uint VIEWS = 1;  // of the plan, at least push.views
#include "depth/words.glsl"
#include "texels.glsl"
WORDS_OF(0, census)
TEXELS(1, float, priors)
layout(set = 0, binding = 2, std140) uniform Views { DepthViews views; };
layout(set = 0, binding = 3, std430) writeonly buffer Volume { uvec4 volume[]; };
layout(push_constant) uniform Push { DepthPush push; };
#include "depth/project.glsl"

uint distance_to(uint own, int pixel) { return uint(bitCount(own ^ WORD(census, pixel))); }

// The distances of four planes in a view.
uvec4 distances(uint own, int base, vec3 h, vec3 e, vec4 w, out bvec4 inside) {
  ivec4 at = base + pixels_in(h, e, w, inside);
  return uvec4(distance_to(own, at.x), distance_to(own, at.y), distance_to(own, at.z), distance_to(own, at.w));
}

void main() {
  uint k = gl_GlobalInvocationID.x, area = push.width * push.height;
  if (k >= push.width * push.rows) return;
  vec2 uv = vec2(k % push.width, push.strip + k / push.width);
  int pixel = int(push.strip * push.width + k);
  uint own = WORD(census, pixel);
  float prior = TEXEL(priors, pixel).x;
  // Outside the loop, because on lavapipe reading a uniform block is slower than the arithmetic.
  vec3 h[VIEWS], e[VIEWS];
  for (uint view = 0u; view < VIEWS; ++view) h[view] = ray_in(view, uv), e[view] = epipole_of(view);
  for (uint quad = 0u; quad < QUADS; ++quad) {
    uvec4 packed;
    for (uint i = 0u; i < 4u; ++i) {
      vec4 planes = vec4(16u * quad + 4u * i) + vec4(0, 1, 2, 3);
      precise vec4 w = push.first + push.step * planes;
      uvec4 sum;
      bvec4 seen;
      if (VIEWS == 1u) {
        sum = distances(own, int(area), h[0], e[0], w, seen);
      } else {
        uvec4 b0 = uvec4(255u), b1 = b0, b2 = b0, b3 = b0;  // the four smallest, in order
        uvec4 count = uvec4(0u);
        for (uint view = 0u; view < VIEWS; ++view) {
          if (view >= push.views) break;
          bvec4 inside;
          uvec4 c = distances(own, int((view + 1u) * area), h[view], e[view], w, inside);
          c = mix(uvec4(255u), c, inside);
          count += uvec4(inside);
          uvec4 more = max(b0, c);
          b0 = min(b0, c);
          c = max(b1, more), b1 = min(b1, more);
          more = max(b2, c), b2 = min(b2, c);
          b3 = min(b3, more);
        }
        seen = greaterThan(count, uvec4(0u));
        sum = b0 + mix(uvec4(0u), b1, greaterThan(count, uvec4(2u))) + mix(uvec4(0u), b2, greaterThan(count, uvec4(4u))) +
              mix(uvec4(0u), b3, greaterThan(count, uvec4(6u)));
        sum = uvec4(vec4(sum) / vec4(max(count + 1u, 2u) / 2u));
      }
      sum = mix(uvec4(ICLK_DEPTH_OUTSIDE), sum, seen);
      if (prior >= 0.0) {
        vec4 away = min(ICLK_DEPTH_PRIOR_SLOPE * abs(planes - prior), float(ICLK_CENSUS_BITS));
        sum = (sum + 3u * uvec4(away)) / 4u;
      }
      packed[i] = pack(sum);
    }
    volume[k * QUADS + quad] = packed;
  }
}
