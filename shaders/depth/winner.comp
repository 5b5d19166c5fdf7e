#version 460
// The plane with the least sum over the eight paths, between planes by a parabola; how much better it is than any that is not
// its neighbour; and a claim on the pixel of each view where it lies, which the claim with the least sum wins.
// Groups: (ceil(width height / local size), 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "depth/depth.h"
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint WORDS = 32;
#include "depth/words.glsl"
WORDS_OF(0, path0)
WORDS_OF(1, path1)
WORDS_OF(2, path2)
WORDS_OF(3, path3)
WORDS_OF(4, path4)
WORDS_OF(5, path5)
WORDS_OF(6, path6)
WORDS_OF(7, path7)
layout(set = 0, binding = 8, std140) uniform Views { DepthViews views; };
layout(set = 0, binding = 9, std430) writeonly buffer Winners { vec2 winners[]; };  // plane, confidence
layout(set = 0, binding = 10, std430) buffer Claims { uint claims[]; };
layout(push_constant) uniform Push { DepthPush push; };
#include "depth/project.glsl"

uint sums[2u * WORDS];  // two planes a word

uint sum_of(uint plane) { return sums[plane / 2u] >> 16u * (plane % 2u) & 0xffffu; }

void main() {
  uint k = gl_GlobalInvocationID.x, area = push.width * push.height;
  if (k >= area) return;
  uint best = 0u, least = 0xffffffffu;
  for (uint word = 0u; word < WORDS; ++word) {
    int i = int(k * WORDS + word);
    uvec4 s = unpack(WORD(path0, i)) + unpack(WORD(path1, i)) + unpack(WORD(path2, i)) + unpack(WORD(path3, i)) +
              unpack(WORD(path4, i)) + unpack(WORD(path5, i)) + unpack(WORD(path6, i)) + unpack(WORD(path7, i));
    sums[2u * word] = s.x | s.y << 16;
    sums[2u * word + 1u] = s.z | s.w << 16;
    if (s.x < least) least = s.x, best = 4u * word;
    if (s.y < least) least = s.y, best = 4u * word + 1u;
    if (s.z < least) least = s.z, best = 4u * word + 2u;
    if (s.w < least) least = s.w, best = 4u * word + 3u;
  }
  uint second = 0xffffu, planes = 4u * WORDS;
  for (uint pair = 0u; pair < 2u * WORDS; ++pair) {
    uint word = sums[pair];
    if (abs(int(2u * pair) - int(best)) > 1) second = min(second, word & 0xffffu);
    if (abs(int(2u * pair + 1u) - int(best)) > 1) second = min(second, word >> 16);
  }
  float position = float(best);
  if (best > 0u && best + 1u < planes) {
    float below = float(sum_of(best - 1u)), above = float(sum_of(best + 1u)), bend = below + above - 2.0 * float(least);
    if (bend > 0.0) position += 0.5 * (below - above) / bend;
  }
  float confidence = float(second - least) / float(max(second, 1u));
  winners[k] = vec2(confidence >= push.uniqueness ? position : -1.0, confidence);

  vec2 uv = vec2(k % push.width, k / push.width);
  precise float w = push.first + push.step * float(best);
  for (uint view = 0u; view < push.views; ++view) {
    int pixel = pixel_in(ray_in(view, uv), epipole_of(view), w);
    if (pixel >= 0) atomicMin(claims[view * area + uint(pixel)], least << 16 | best);
  }
}
