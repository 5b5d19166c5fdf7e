#version 460
// Inverse depth between the planes: Gauss-Newton on the grey values of a 7x7 patch, with gain and bias of each view eliminated.
// The patch is a plane in space, with the slope that the neighbours have: inverse depth is affine over it.
// Groups: (ceil(width height / local size), 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
#include "texels.glsl"
TEXELS(0, float, grey)
TEXELS(1, float, planes)
layout(set = 0, binding = 2, std140) uniform Views { DepthViews views; };
layout(set = 0, binding = 3, std430) writeonly buffer Inverse { float inverse_depth[]; };
layout(push_constant) uniform Push { DepthPush push; };
#include "depth/project.glsl"

const float STEP = 0.25;         // planes: of the numerical derivative
const float LEAST_CORRELATION = 0.6;
const float MOST = 1.0;          // planes that a pixel may move
const float SLOPE_LIMIT = 1.5;   // planes a pixel: what is more is an edge

float plane_at(ivec2 at) {
  at = clamp(at, ivec2(0), ivec2(push.width, push.height) - 1);
  return TEXEL(planes, at.y * int(push.width) + at.x).x;
}

// Least-squares slope along a line through five pixels on either side; neighbours across an edge do not count.
float slope(ivec2 at, ivec2 way, float own) {
  float sum = 0.0, weight = 0.0;
  for (int i = 1; i <= 5; ++i) {
    float a = plane_at(at - i * way), b = plane_at(at + i * way), far = SLOPE_LIMIT * float(i);
    if (a >= 0.0 && abs(a - own) <= far) sum += float(i) * (own - a), weight += float(i * i);
    if (b >= 0.0 && abs(b - own) <= far) sum += float(i) * (b - own), weight += float(i * i);
  }
  return weight > 0.0 ? sum / weight : 0.0;
}

float grey_in(int base, vec2 uv) {
  vec2 low = floor(uv), f = uv - low;
  int at = base + int(low.y) * int(push.width) + int(low.x), down = at + int(push.width);
  return mix(mix(TEXEL(grey, at).x, TEXEL(grey, at + 1).x, f.x), mix(TEXEL(grey, down).x, TEXEL(grey, down + 1).x, f.x), f.y);
}

bool inside(vec3 x) {
  return x.z > 0.0 && x.x >= 0.0 && x.y >= 0.0 && x.x < float(push.width - 1u) * x.z && x.y < float(push.height - 1u) * x.z;
}

void main() {
  uint k = gl_GlobalInvocationID.x, area = push.width * push.height;
  if (k >= area) return;
  ivec2 at = ivec2(k % push.width, k / push.width);
  float start = plane_at(at), plane = start;
  if (start < 0.0) {
    inverse_depth[k] = 0.0;
    return;
  }
  vec2 gradient = vec2(slope(at, ivec2(1, 0), start), slope(at, ivec2(0, 1), start));
  ivec2 low = max(at - ICLK_POLISH_RADIUS, ivec2(0)), high = min(at + ICLK_POLISH_RADIUS, ivec2(push.width, push.height) - 1);
  float count = float((high.x - low.x + 1) * (high.y - low.y + 1));
  for (uint i = 0u; i < push.iterations; ++i) {
    float top = 0.0, bottom = 0.0;
    for (uint view = 0u; view < push.views; ++view) {
      vec3 e = epipole_of(view);
      int base = int((view + 1u) * area);
      float a1 = 0.0, d1 = 0.0, y1 = 0.0, aa = 0.0, dd = 0.0, yy = 0.0, ad = 0.0, ay = 0.0, dy = 0.0;
      bool seen = true;
      for (int v = low.y; v <= high.y; ++v)
        for (int u = low.x; u <= high.x; ++u) {
          vec3 h = ray_in(view, vec2(u, v));
          float p = plane + dot(gradient, vec2(u - at.x, v - at.y));
          vec3 nearer = h + e * (push.first + push.step * (p + STEP)), farther = h + e * (push.first + push.step * (p - STEP));
          if (!(inside(nearer) && inside(farther))) {
            seen = false;
            continue;
          }
          float b = grey_in(base, nearer.xy / nearer.z), c = grey_in(base, farther.xy / farther.z);
          float a = TEXEL(grey, v * int(push.width) + u).x, y = 0.5 * (b + c), d = (b - c) / (2.0 * STEP);
          a1 += a, d1 += d, y1 += y;
          aa += a * a, dd += d * d, yy += y * y, ad += a * d, ay += a * y, dy += d * y;
        }
      if (!seen) continue;
      aa -= a1 * a1 / count, dd -= d1 * d1 / count, yy -= y1 * y1 / count;
      ad -= a1 * d1 / count, ay -= a1 * y1 / count, dy -= d1 * y1 / count;
      // Flat patches say nothing, bad matches are hidden here.
      if (!(aa > 1e-6 * count) || !(yy > 0.0) || ay < LEAST_CORRELATION * sqrt(aa * yy)) continue;
      top += (dy - ad * ay / aa) / aa;
      bottom += (dd - ad * ad / aa) / aa;
    }
    if (!(bottom > 1e-4)) break;
    plane = clamp(plane - clamp(top / bottom, -0.5, 0.5), start - MOST, start + MOST);
  }
  inverse_depth[k] = push.first + push.step * plane;
}
