#version 460
// Inverse depth between the planes: Gauss-Newton on the grey values of a 7x7 patch, with gain and bias of each view eliminated.
// The patch is a plane in space with the slope of its neighbours: its inverse depth is affine.
// Groups: (ceil(width height / local size), 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
#include "texels.glsl"
TEXELS(0, float, grey)
TEXELS(1, float, planes)
layout(set = 0, binding = 2, std140) uniform Views { DepthViews views; };
layout(set = 0, binding = 3, std430) writeonly buffer Better { float better[]; };
TEXELS(4, vec4, corners)
layout(push_constant) uniform Push { DepthPush push; };
#include "depth/project.glsl"
#include "depth/slope.glsl"

const float LEAST_CORRELATION = 0.6;
const float MOST = 0.5;  // the most planes that a pixel may move

void main() {
  uint k = gl_GlobalInvocationID.x, area = push.width * push.height;
  if (k >= area) return;
  ivec2 at = ivec2(k % push.width, k / push.width);
  float plane = plane_at(at);
  if (plane < 0.0) {
    better[k] = plane;
    return;
  }
  vec2 gradient = slopes(at, plane);
  const float count = float((2 * ICLK_POLISH_RADIUS + 1) * (2 * ICLK_POLISH_RADIUS + 1));
  vec2 last = vec2(push.width, push.height) - 1.0;
  float top = 0.0, bottom = 0.0;
  for (uint view = 0u; view < push.views; ++view) {
    int base = int((view + 1u) * area);
    vec3 a_plane = epipole_of(view) * push.step;
    vec3 right = ray_right(view) + a_plane * gradient.x, down = ray_down(view) + a_plane * gradient.y;
    vec3 middle = ray_in(view, vec2(at)) + epipole_of(view) * push.first + a_plane * plane;
    float a1 = 0.0, d1 = 0.0, y1 = 0.0, aa = 0.0, dd = 0.0, yy = 0.0, ad = 0.0, ay = 0.0, dy = 0.0;
    bool seen = true;
    // At the border, pixels count more than once, in both images.
    for (int j = -ICLK_POLISH_RADIUS; j <= ICLK_POLISH_RADIUS; ++j) {
      int v = clamp(at.y + j, 0, int(push.height) - 1), row = v * int(push.width);
      vec3 beginning = middle + float(v - at.y) * down;
      for (int i = -ICLK_POLISH_RADIUS; i <= ICLK_POLISH_RADIUS; ++i) {
        int u = clamp(at.x + i, 0, int(push.width) - 1);
        vec3 x = beginning + float(u - at.x) * right;
        float scale = 1.0 / x.z;
        vec2 uv = x.xy * scale;
        bool inside = x.z > 0.0 && uv.x >= 0.0 && uv.y >= 0.0 && uv.x < last.x && uv.y < last.y;
        seen = seen && inside;
        vec2 way = scale * (a_plane.xy - uv * a_plane.z);  // pixels per plane
        vec2 low = floor(uv), f = uv - low;
        vec4 g = TEXEL(corners, inside ? base + int(low.y) * int(push.width) + int(low.x) : base);
        vec2 upper_lower = mix(g.xz, g.yw, f.x), rise = g.yw - g.xz;
        float fall = upper_lower.y - upper_lower.x;
        float a = TEXEL(grey, row + u).x, y = upper_lower.x + f.y * fall, d = way.x * mix(rise.x, rise.y, f.y) + way.y * fall;
        a1 += a, d1 += d, y1 += y;
        aa += a * a, dd += d * d, yy += y * y, ad += a * d, ay += a * y, dy += d * y;
      }
    }
    if (!seen) continue;
    aa -= a1 * a1 / count, dd -= d1 * d1 / count, yy -= y1 * y1 / count;
    ad -= a1 * d1 / count, ay -= a1 * y1 / count, dy -= d1 * y1 / count;
    // Flat patches have no information; bad matches are hidden in this view.
    if (!(aa > 1e-6 * count) || !(yy > 0.0) || ay < LEAST_CORRELATION * sqrt(aa * yy)) continue;
    top += (dy - ad * ay / aa) / aa;
    bottom += (dd - ad * ad / aa) / aa;
  }
  better[k] = bottom > 1e-4 ? max(plane - clamp(top / bottom, -MOST, MOST), 0.0) : plane;
}
