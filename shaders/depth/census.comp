#version 460
// Census: for each pair of opposite positions around a pixel, one bit for which is brighter, independent of gain and bias. A
// view may be rotated or scaled relative to the reference; its positions are mapped by the plane in the middle of the range.
// Groups: (ceil(width height / local size), 1, images).
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
#include "texels.glsl"
TEXELS(0, vec4, corners)
layout(set = 0, binding = 1, std140) uniform Views { DepthViews views; };
layout(set = 0, binding = 2, std430) writeonly buffer Census { uint census[]; };
layout(push_constant) uniform Push { DepthPush push; };

// The least ratio of the plane's depth in the reference to that in the view. Below it, the patch is too small or behind the
// view.
const float LEAST_NEARNESS = 0.05;

// The bilinear grey value, exact at whole pixels.
float grey_of(int base, vec2 at) {
  at = clamp(at, vec2(0), vec2(push.width, push.height) - 1.0);
  vec2 low = floor(at), f = at - low;
  vec4 g = TEXEL(corners, base + int(low.y) * int(push.width) + int(low.x));
  vec2 ends = g.xz + f.x * (g.yw - g.xz);
  return ends.x + f.y * (ends.y - ends.x);
}

// Maps offsets in the reference to offsets around a pixel of a view.
mat2 warp_at(uint view, vec2 uv) {
  vec3 row_u = views.view[view].back_u.xyz, row_v = views.view[view].back_v.xyz, row_z = views.view[view].back_z.xyz;
  vec3 at = vec3(uv, 1);
  float z = dot(row_z, at);
  if (z < LEAST_NEARNESS) return mat2(1);
  vec2 x = vec2(dot(row_u, at), dot(row_v, at)) / z;
  return inverse(mat2(vec2(row_u.x, row_v.x) - x * row_z.x, vec2(row_u.y, row_v.y) - x * row_z.y) / z);
}

void main() {
  uint k = gl_GlobalInvocationID.x, area = push.width * push.height, image = gl_WorkGroupID.z;
  if (k >= area) return;
  int base = int(image * area);
  vec2 at = vec2(k % push.width, k / push.width);
  mat2 warp = image == 0u ? mat2(1) : warp_at(max(image, 1u) - 1u, at);
  uint bits = 0u;
  for (int v = 0; v <= ICLK_CENSUS_RADIUS_V; ++v)
    for (int u = v == 0 ? 1 : -ICLK_CENSUS_RADIUS_U; u <= ICLK_CENSUS_RADIUS_U; ++u) {
      vec2 offset = warp * vec2(u, v);
      bits = bits << 1 | uint(grey_of(base, at + offset) > grey_of(base, at - offset));
    }
  census[uint(base) + k] = bits;
}
