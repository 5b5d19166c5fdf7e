#version 460
// Robust weights of a level from its starting residuals (align/internal/weights.h): the scale is 1.4826 times the lower
// median of |r|, found exactly by a radix selection over the bits of |r| (non-negative floats order like their
// bits), then one weight a residual. Groups: (pairs, 1, 1), one workgroup a pair.
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint ROBUST = ICLK_ROBUST_HUBER;
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer Pairs { PairInfo pairs[]; };
layout(set = 0, binding = 2, std430) readonly buffer Residuals { float residuals[]; };
layout(set = 0, binding = 3, std430) writeonly buffer Weights { float weights[]; };
layout(set = 0, binding = 4, std430) buffer States { PairState states[]; };
layout(push_constant) uniform Push { IteratePush push; };

#define BINS 256u
shared uint histogram[BINS];
shared uint prefix, rank;

void main() {
  uint pair = gl_WorkGroupID.x, lane = gl_LocalInvocationIndex, lanes = gl_WorkGroupSize.x;
  if (pairs[pair].enabled == 0u) return;
  uint count = levels[push.level].element_count, base = pair * push.weight_stride;
  if (lane == 0u) prefix = 0u;

  // Four digits of eight bits, the most significant first: after each, the median's leading bits are `prefix`.
  for (int shift = 24; shift >= 0; shift -= 8) {
    for (uint i = lane; i < BINS; i += lanes) histogram[i] = 0u;
    barrier();
    uint head = prefix;
    for (uint k = lane; k < count; k += lanes) {
      uint bits = floatBitsToUint(abs(residuals[base + k]));
      bool counts = bits < floatBitsToUint(1e38) && (shift == 24 || (bits >> uint(shift + 8)) == head);
      if (counts) atomicAdd(histogram[(bits >> uint(shift)) & 255u], 1u);
    }
    barrier();
    if (lane == 0u) {
      uint total = 0u;
      if (shift == 24) {
        for (uint i = 0u; i < BINS; ++i) total += histogram[i];
        rank = total == 0u ? 0xffffffffu : (total - 1u) / 2u;
      }
      uint left = rank, digit = 0u;
      bool found = false;
      for (uint i = 0u; i < BINS; ++i) {
        if (!found) {
          if (left < histogram[i]) {
            digit = i;
            found = true;
          } else {
            left -= histogram[i];
          }
        }
      }
      if (rank != 0xffffffffu) rank = left;
      prefix = (head << 8) | digit;
    }
    barrier();
  }
  float scale = rank == 0xffffffffu ? 0.0 : max(1.4826 * uintBitsToFloat(prefix), ICLK_LEAST_SCALE);
  for (uint k = lane; k < count; k += lanes) {
    float r = residuals[base + k], w;
    if (ROBUST == ICLK_ROBUST_HUBER) {
      w = min(1.0, ICLK_HUBER * scale / max(abs(r), 1e-12));
    } else if (ROBUST == ICLK_ROBUST_TUKEY) {
      float x = r / (ICLK_TUKEY * scale), y = max(1.0 - x * x, 0.0);
      w = y * y;
    } else {
      float x = r / (ICLK_CAUCHY * scale);
      w = 1.0 / (1.0 + x * x);
    }
    weights[base + k] = abs(r) < 1e38 ? w : 0.0;
  }
  if (lane == 0u) states[pair].scale[push.level] = scale;
}
