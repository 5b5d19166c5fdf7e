#version 460
// Renders a view of a terrain: colour and z-depth from heights and a mosaic. One invocation per pixel.
//
// The ground is the surface of bilinear patches between the points of the height grid. A ray walks the pyramid of greatest
// heights and solves a quadratic equation in each patch that it may meet, to find its first crossing from above. Colour is the
// mean of SAMPLES x SAMPLES rays, each with a trilinear, anisotropic sample of the mosaic. Depth is that of the pixel's centre;
// 0 if the ray meets no ground or ground without a picture.
// Groups: (ceil(tile width / 8), ceil(tile height / 8)).
#extension GL_GOOGLE_include_directive : require
#include "render/render.h"
layout(local_size_x = 8, local_size_y = 8) in;
layout(constant_id = 0) const uint SAMPLES = 2;
layout(constant_id = 1) const uint MAX_ANISOTROPY = 16;
layout(constant_id = 2) const uint LENS = ICLK_LENS_NONE;

#include "texels.glsl"
TEXELS(0, float, relief)
#ifdef ICLK_STORAGE_READS
layout(set = 0, binding = 1, std430) readonly buffer Mosaic { uint mosaic_words[]; };
vec4 mosaic_at(int i) { return unpackUnorm4x8(mosaic_words[i]); }
#else
TEXELS(1, vec4, mosaic)
#endif
layout(set = 0, binding = 2, std140) uniform Levels { RenderLevels levels; };
layout(set = 0, binding = 3, std430) writeonly buffer Colours { uint colours[]; };
layout(set = 0, binding = 4, std430) writeonly buffer Depths { float depths[]; };
layout(push_constant) uniform Push { RenderPush push; };

const float FAR = 1e30;
const uint RAYS = SAMPLES == 1u ? 1u : SAMPLES * SAMPLES + 1u;
const int STEPS = int(ICLK_RENDER_STEPS / RAYS);

#include "render/lens.glsl"

vec3 ray_u, ray_v;  // the change of the last ray's direction per pixel
vec2 slope;         // of the ground where the last ray met it: dh/dx, dh/dy

float height(ivec2 point) {
  RenderWindow w = levels.relief[0];
  float h = TEXEL(relief, w.offset + (point.y - w.y) * w.width + point.x - w.x).x;
  return (h - push.height_high) - push.height_low;
}

// The z-depth at which the ray along `d` first meets the ground. 0: it meets none, or comes from below through a hole.
float meet(vec3 d) {
  vec2 fraction = vec2(push.cell_fraction_x, push.cell_fraction_y);
  ivec2 camera = ivec2(push.cell_x, push.cell_y);
  // Cells of the grid per step of depth; rows go south.
  vec2 e = vec2(d.x * levels.cells_per_metre_x, -d.y * levels.cells_per_metre_y);
  bvec2 forward = greaterThanEqual(e, vec2(0.0));
  vec2 inverse = vec2(abs(e.x) < 1e-20 ? FAR : 1.0 / e.x, abs(e.y) < 1e-20 ? FAR : 1.0 / e.y);
  ivec2 ahead = ivec2(forward), step = 2 * ahead - 1;

  RenderWindow cells = levels.relief[1];
  vec2 low = vec2(ivec2(cells.x, cells.y) - camera) - fraction, high = low + vec2(cells.width, cells.height);
  vec2 enter = mix(high, low, forward) * inverse, leave = mix(low, high, forward) * inverse;
  float t = max(max(enter.x, enter.y), 0.0), end = min(leave.x, leave.y);
  if (t * d.z > push.top) {
    if (d.z >= 0.0) return 0.0;
    t = push.top / d.z;
  }
  if (!(t < end)) return 0.0;

  int level = int(push.levels & 255u);
  ivec2 cell = clamp(camera + ivec2(floor(fraction + t * e)), ivec2(cells.x, cells.y),
                     ivec2(cells.x + cells.width, cells.y + cells.height) - 1) >> level;
  for (int i = 0; i < STEPS; ++i) {
    RenderWindow w = levels.relief[level + 1];
    ivec2 at = cell - ivec2(w.x, w.y);
    if (any(lessThan(at, ivec2(0))) || at.x >= w.width || at.y >= w.height) return 0.0;
    float greatest = TEXEL(relief, w.offset + at.y * w.width + at.x).x;
    greatest = (greatest - push.height_high) - push.height_low;

    vec2 border = (vec2(((cell + ahead) << level) - camera) - fraction) * inverse;
    float next = max(min(border.x, border.y), t);
    if (min(t * d.z, next * d.z) <= greatest) {
      if (level > 0) {
        // Advances to where the ground of this square can begin.
        if (t * d.z > greatest) t = clamp(greatest / d.z, t, next);
        --level;
        vec2 middle = vec2(((2 * cell + 1) << level) - camera) - fraction;
        cell = 2 * cell + ivec2(greaterThanEqual(t * e, middle));
        continue;
      }
      float a = height(cell), b = height(cell + ivec2(1, 0)), c = height(cell + ivec2(0, 1)), abcd = height(cell + 1);
      vec3 g = vec3(b - a, c - a, abcd - b - c + a);  // ground = a + g.x u + g.y v + g.z u v
      vec2 uv = t * e - (vec2(cell - camera) - fraction);
      float f0 = t * d.z - (a + g.x * uv.x + g.y * uv.y + g.z * uv.x * uv.y);
      float f1 = d.z - g.x * e.x - g.y * e.y - g.z * (uv.x * e.y + uv.y * e.x);
      float f2 = -g.z * e.x * e.y;
      // The ray's height above ground is f0 + f1 s + f2 s^2, s = depth - t.
      float least = -2e-5 * t * (abs(d.x) + abs(d.y) + abs(d.z));
      if (f0 < least) return 0.0;  // below ground: the ray came through a hole or the edge of the map
      float root = f1 * f1 - 4.0 * f2 * f0;
      float divisor = -f1 + sqrt(max(root, 0.0));
      float s = f0 <= 0.0 ? 0.0 : root >= 0.0 && divisor > 0.0 ? 2.0 * f0 / divisor : FAR;
      if (s <= (next - t) * 1.00001 + 1e-6 * t) {
        uv += s * e;
        slope = vec2((g.x + g.z * uv.y) * levels.cells_per_metre_x, -(g.y + g.z * uv.x) * levels.cells_per_metre_y);
        return t + s;
      }
    }
    if (next >= end) return 0.0;
    t = next;
    ivec2 before = cell;
    if (border.x <= border.y)
      cell.x += step.x;
    else
      cell.y += step.y;
    if (level < int(push.levels & 255u) && any(notEqual(cell >> 1, before >> 1))) {
      ++level;
      cell >>= 1;
    }
  }
  return 0.0;
}

// Colour times coverage, and coverage, at texel coordinates x of level 0 (relative to push.texel); bilinear in a level.
vec4 look(vec2 x, int level) {
  RenderWindow w = levels.mosaic[level];
  float size = float(1 << level);
  vec2 p = (x + 0.5) / size - 0.5, whole = floor(p), f = p - whole;
  ivec2 first = ivec2(whole) + (ivec2(push.texel_x, push.texel_y) >> level) - ivec2(w.x, w.y);
  ivec2 last = ivec2(w.width, w.height) - 1, a = clamp(first, ivec2(0), last), b = clamp(first + 1, ivec2(0), last);
  vec4 c00 = TEXEL(mosaic, w.offset + a.y * w.width + a.x), c10 = TEXEL(mosaic, w.offset + a.y * w.width + b.x);
  vec4 c01 = TEXEL(mosaic, w.offset + b.y * w.width + a.x), c11 = TEXEL(mosaic, w.offset + b.y * w.width + b.x);
  vec2 r = 1.0 - f;
  vec4 weight = vec4(c00.a, c10.a, c01.a, c11.a) * vec4(r.x * r.y, f.x * r.y, r.x * f.y, f.x * f.y);
  return vec4(weight.x * c00.rgb + weight.y * c10.rgb + weight.z * c01.rgb + weight.w * c11.rgb,
              weight.x + weight.y + weight.z + weight.w);
}

// The mean over a pixel's footprint with sides du and dv (texels): taps along the long axis, each as wide as the short axis.
vec4 filtered(vec2 x, vec2 du, vec2 dv) {
  float xx = du.x * du.x + dv.x * dv.x, xy = du.x * du.y + dv.x * dv.y, yy = du.y * du.y + dv.y * dv.y;
  float mean = 0.5 * (xx + yy), radius = length(vec2(0.5 * (xx - yy), xy));
  float major = sqrt(mean + radius), minor = sqrt(max(mean - radius, 0.0));
  vec2 axis = xx > yy ? vec2(mean + radius - yy, xy) : vec2(xy, mean + radius - xx);
  float norm = length(axis);
  axis = norm > 0.0 ? axis / norm : vec2(1.0, 0.0);
  minor = max(max(minor, major / float(MAX_ANISOTROPY)), 1.0);
  int taps = clamp(int(ceil(major / minor - 0.25)), 1, int(MAX_ANISOTROPY));
  float finest = float((push.levels >> 16) & 255u), coarsest = float((push.levels >> 8) & 255u);
  float lod = clamp(log2(minor), finest, coarsest);
  int level = int(min(floor(lod), coarsest)), above = min(level + 1, int(coarsest));
  float share = lod - float(level);
  float spacing = taps > 1 ? major / float(taps) : 0.0;
  vec4 sum = vec4(0.0);
  for (int i = 0; i < taps; ++i) {
    vec2 at = x + axis * (spacing * (float(i) - 0.5 * float(taps - 1)));
    sum += mix(look(at, level), look(at, above), share);
  }
  return sum / float(taps);
}

// Colour times coverage, and coverage, where a ray meets the ground at depth t; 0 outside the mosaic.
vec4 shade(vec3 d, float t) {
  vec2 scale = vec2(levels.texels_per_metre_x, -levels.texels_per_metre_y);
  vec2 x = vec2(push.texel_fraction_x, push.texel_fraction_y) + t * d.xy * scale;
  RenderWindow w = levels.mosaic[(push.levels >> 16) & 255u];
  int finest = int((push.levels >> 16) & 255u);
  vec2 level_x = (x + 0.5) / float(1 << finest) + vec2(ivec2(push.texel_x, push.texel_y) >> finest) - vec2(w.x, w.y);
  if (any(lessThan(level_x, vec2(0.0))) || any(greaterThan(level_x, vec2(w.width, w.height)))) return vec4(0.0);

  // The motion on the tangent plane of the ground from this ray to the next, in u and in v.
  vec3 n = vec3(-slope, 1.0);
  float against = min(dot(n, d), -1e-3 * length(n) * length(d));
  vec3 to_u = ray_u / float(SAMPLES), to_v = ray_v / float(SAMPLES);
  vec2 du = t * (to_u.xy - d.xy * (dot(n, to_u) / against)) * scale;
  vec2 dv = t * (to_v.xy - d.xy * (dot(n, to_v) / against)) * scale;
  return filtered(x, du, dv);
}

// Computes the ray of pixel uv. Returns false outside the lens's domain.
bool ray(vec2 uv, out vec3 d) {
  vec3 axis_u = vec3(push.ray_u[0], push.ray_u[1], push.ray_u[2]), axis_v = vec3(push.ray_v[0], push.ray_v[1], push.ray_v[2]);
  if (LENS == ICLK_LENS_NONE) {
    ray_u = axis_u;
    ray_v = axis_v;
    d = vec3(push.ray_0[0], push.ray_0[1], push.ray_0[2]) + uv.x * ray_u + uv.y * ray_v;
    return true;
  }
  vec2 focal = vec2(push.lens[0], push.lens[1]), xy;
  mat2 change;
  bool seen = undistort((uv - vec2(push.lens[2], push.lens[3])) / focal, xy, change);
  ray_u = (change[0].x * axis_u + change[0].y * axis_v) / focal.x;
  ray_v = (change[1].x * axis_u + change[1].y * axis_v) / focal.y;
  d = cross(axis_u, axis_v) + xy.x * axis_u + xy.y * axis_v;
  return seen;
}

void main() {
  uvec2 in_tile = gl_GlobalInvocationID.xy;
  if (in_tile.x >= (push.tile & 0xffffu) || in_tile.y >= push.tile >> 16) return;
  uvec2 pixel = in_tile + uvec2(push.corner & 0xffffu, push.corner >> 16);
  uint at = pixel.y * (push.size & 0xffffu) + pixel.x;

  vec3 d;
  float depth = ray(vec2(pixel), d) ? meet(d) : 0.0;
  vec4 centre = depth > 0.0 ? shade(d, depth) : vec4(0.0);
  if (centre.a < 0.5) {
    colours[at] = levels.background;
    depths[at] = 0.0;
    return;
  }
  vec4 sum = centre;
  if (SAMPLES > 1u) {
    sum = vec4(0.0);
    for (uint i = 0; i < SAMPLES * SAMPLES; ++i) {
      vec2 offset = (vec2(i % SAMPLES, i / SAMPLES) + 0.5) / float(SAMPLES) - 0.5;
      vec3 d_i;
      float t = ray(vec2(pixel) + offset, d_i) ? meet(d_i) : 0.0;
      if (t > 0.0) sum += shade(d_i, t);
    }
    if (sum.a <= 0.0) sum = centre;
  }
  colours[at] = packUnorm4x8(vec4(sum.rgb / sum.a, 1.0));
  depths[at] = depth;
}
