#version 460
// Finds the plane with the least sum over the eight paths, interpolated by a parabola. The confidence is how much better it is
// than all planes that are not adjacent. It also makes a claim on its pixel in each view; the claim with the least sum wins.
// Groups: (ceil(width (answered_end - answered) / local size), 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint QUADS = 8;
#include "depth/words.glsl"
QUADS_OF(0, path0)
QUADS_OF(1, path1)
QUADS_OF(2, path2)
QUADS_OF(3, path3)
QUADS_OF(4, path4)
QUADS_OF(5, path5)
QUADS_OF(6, path6)
QUADS_OF(7, path7)
layout(set = 0, binding = 8, std140) uniform Views { DepthViews views; };
layout(set = 0, binding = 9, std430) writeonly buffer Winners { vec2 winners[]; };  // plane, confidence
layout(set = 0, binding = 10, std430) buffer Claims { uint claims[]; };
layout(push_constant) uniform Push { DepthPush push; };
#include "depth/project.glsl"

// Planes 0 and 2, and 1 and 3, of every word, 16 bits each.
uvec4 even(uvec4 words) { return words & 0x00ff00ffu; }
uvec4 odd(uvec4 words) { return words >> 8 & 0x00ff00ffu; }

// Plane by plane, without an array of sums: the best one so far, the sums beside it, the least of the others.
const uint NONE = 0xffffu;
uint best = 0u, least = NONE, below = NONE, above = NONE, second = NONE;
uint last = NONE, before = NONE;  // the last plane's sum; the least of the planes before that
void take(uint sum, uint plane) {
  bool better = sum < least, beside = plane == best + 1u;
  second = better ? before : beside ? second : min(second, sum);
  above = better ? NONE : beside ? sum : above;
  below = better ? last : below;
  best = better ? plane : best;
  least = min(least, sum);
  before = min(before, last);
  last = sum;
}

void main() {
  uint k = push.answered * push.width + gl_GlobalInvocationID.x, area = push.width * push.height;
  if (k >= push.answered_end * push.width) return;
  uint first = (k - push.strip * push.width) * QUADS;
  for (uint quad = 0u; quad < QUADS; ++quad) {
    int i = int(first + quad);
    uvec4 words[ICLK_DEPTH_PATHS] = uvec4[](QUAD(path0, i), QUAD(path1, i), QUAD(path2, i), QUAD(path3, i), QUAD(path4, i),
                                            QUAD(path5, i), QUAD(path6, i), QUAD(path7, i));
    uvec4 evens = uvec4(0u), odds = uvec4(0u);
    for (int path = 0; path < ICLK_DEPTH_PATHS; ++path) evens += even(words[path]), odds += odd(words[path]);
    for (uint word = 0u; word < 4u; ++word) {
      uint plane = 16u * quad + 4u * word;
      take(evens[word] & 0xffffu, plane);
      take(odds[word] & 0xffffu, plane + 1u);
      take(evens[word] >> 16, plane + 2u);
      take(odds[word] >> 16, plane + 3u);
    }
  }
  float position = float(best);
  if (below != NONE && above != NONE) {
    float bend = float(below) + float(above) - 2.0 * float(least);
    if (bend > 0.0) position += 0.5 * (float(below) - float(above)) / bend;
  }
  float confidence = float(second - least) / float(max(second, 1u));
  bool unique = confidence >= push.uniqueness, seen = false;

  vec2 uv = vec2(k % push.width, k / push.width);
  precise float w = push.first + push.step * float(best);
  for (uint view = 0u; view < push.views; ++view) {
    int pixel = pixel_in(ray_in(view, uv), epipole_of(view), w);
    if (pixel < 0) continue;
    seen = true;
    atomicMin(claims[view * area + uint(pixel)], least << 16 | best);
  }
  winners[k] = vec2(unique ? position : -1.0, seen ? confidence : 0.0);
}
