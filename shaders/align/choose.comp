#version 460
// Chooses features of a reference whose depth the application has rendered: in each cell the pixel with the most texture.
// Texture is the smaller eigenvalue of the gradients' matrix over 3x3 pixels. Pixels whose patch has one depth come first, then
// those at depth edges. Every second pixel is tested. A cell without depth or texture gets a feature with inverse depth 0,
// which is unused.
// Groups: (columns, rows, 1); the invocations of a group share the pixels of its cell.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_samplerless_texture_functions : require
#extension GL_EXT_control_flow_attributes : require
#include "shared.h"
#include "finite.glsl"
layout(local_size_x = ICLK_CHOOSE_GROUP) in;
#include "pixels.glsl"
layout(set = 0, binding = 1) uniform texture2D depths;
layout(set = 0, binding = 2, std430) writeonly buffer FeatureList { FeatureInfo features[]; };
layout(push_constant) uniform Push { ChoosePush push; };

shared float best_score[ICLK_CHOOSE_GROUP];
shared uint best_place[ICLK_CHOOSE_GROUP];

float grey(ivec2 p) { return luma(colour(push.first_word, uint(p.y) * push.row_pixels + uint(p.x))); }

// The inverse depth of a pixel; 0: unknown.
float inverse_depth(ivec2 p) {
  float d = texelFetch(depths, p, 0).x, value = push.scale * d + push.offset;
  float q = push.inverse != 0u ? value : 1.0 / value;
  bool seen = is_finite(value) && is_finite(q) && floatBitsToUint(d) != floatBitsToUint(push.background);
  return seen && q > 0.0 ? q : 0.0;
}

// The smaller eigenvalue of the mean matrix of central differences.
float texture_at(ivec2 p) {
  float xx = 0.0, xy = 0.0, yy = 0.0;
  [[dont_unroll]] for (int dv = -1; dv <= 1; ++dv) {
    ivec2 at = p + ivec2(0, dv);
    float row[5] = float[5](grey(at - ivec2(2, 0)), grey(at - ivec2(1, 0)), grey(at), grey(at + ivec2(1, 0)),
                            grey(at + ivec2(2, 0)));
    [[unroll]] for (int i = 0; i < 3; ++i) {
      float gu = 0.5 * (row[i + 2] - row[i]), gv = 0.5 * (grey(at + ivec2(i - 1, 1)) - grey(at + ivec2(i - 1, -1)));
      xx += gu * gu;
      xy += gu * gv;
      yy += gv * gv;
    }
  }
  float half_trace = 0.5 * (xx + yy), half_difference = 0.5 * (xx - yy);
  return (half_trace - sqrt(half_difference * half_difference + xy * xy)) / 9.0;
}

// Whether the patch around p has one depth.
bool smooth_at(ivec2 p, float q) {
  float nearest = 0.0, farthest = 3.0e38;
  [[dont_unroll]] for (int k = 0; k < 16; ++k) {
    ivec2 step = ivec2(k & 3, k >> 2);
    float here = inverse_depth(p - ICLK_PATCH_BEFORE + 2 * step + step / 3);  // 0, 2, 4, 7 of the patch's pixels
    nearest = max(nearest, here);
    farthest = min(farthest, here);
  }
  return farthest > 0.0 && q / farthest - q / nearest <= ICLK_CHOOSE_SPREAD;
}

void main() {
  uint lane = gl_LocalInvocationID.x;
  uvec2 cell = gl_WorkGroupID.xy, size = uvec2(push.width, push.height), lattice = uvec2(push.columns, push.rows);
  uvec2 first = push.border + size * cell / lattice, last = push.border + size * (cell + 1u) / lattice;
  uvec2 looked_at = (last - first + 1u) / 2u;
  float best = 0.0;
  uint place = 0u;
  for (uint k = lane; k < looked_at.x * looked_at.y; k += ICLK_CHOOSE_GROUP) {
    ivec2 p = ivec2(first + 2u * uvec2(k % looked_at.x, k / looked_at.x));
    float q = inverse_depth(p), score = texture_at(p);
    if (!(q > 0.0) || !is_finite(score)) continue;
    if (!smooth_at(p, q)) score *= 1e-12;
    if (score > best) {
      best = score;
      place = k;
    }
  }
  best_score[lane] = best;
  best_place[lane] = place;
  barrier();
  if (lane != 0u) return;
  for (uint i = 1u; i < ICLK_CHOOSE_GROUP; ++i)
    if (best_score[i] > best || (best_score[i] == best && best_place[i] < place)) {
      best = best_score[i];
      place = best_place[i];
    }
  ivec2 p = ivec2(first + 2u * uvec2(place % looked_at.x, place / looked_at.x));
  bool found = best > 0.0;
  // A position outside the reach of all patches in the image, because masks depend on positions only.
  features[push.first_feature + cell.y * push.columns + cell.x] =
      found ? FeatureInfo(float(p.x), float(p.y), inverse_depth(p), 0.0) : FeatureInfo(-32768.0, -32768.0, 0.0, 0.0);
}
