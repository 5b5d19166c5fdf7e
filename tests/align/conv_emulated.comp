#version 460
// conv_cooperative.glsl where there are no cooperative matrices: the same tiles in the same order. A and B stay in shared
// memory, as it does not change while they are in use; C is spread over the subgroup's lanes, four or more of them. Few loops:
// lavapipe ends those of an invocation after 65,535 turns, all of them together.
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_EXT_control_flow_attributes : require
layout(constant_id = 2) const int TM = 16;
layout(constant_id = 3) const int TN = 16;
layout(constant_id = 4) const int TK = 16;
#define UNROLL
#define HALF4 uvec2
uvec2 halves(vec4 x) { return uvec2(packHalf2x16(x.xy), packHalf2x16(x.zw)); }
vec4 singles(uvec2 x) { return vec4(unpackHalf2x16(x.x), unpackHalf2x16(x.y)); }

struct Place {
  int at, stride;
  bool low;
};
struct Sums {
  float at[64];
};
#define MATRIX_A Place
#define MATRIX_B Place
#define MATRIX_C Sums
const bool of_patch_high = false, of_patch_low = true, of_taps_high = false, of_taps_low = true;
#define LOAD_A(matrix, array, from, stride) matrix = Place(from, stride, of_##array)
#define LOAD_B LOAD_A
// Every so many elements of C one is a lane's.
#define MINE(n, i) int n = 0, i = int(gl_SubgroupInvocationID); i < TM * TN; ++n, i += int(gl_SubgroupSize)
#define STORE_C(matrix, array, from, stride)                                                 \
  {                                                                                          \
    Sums stored = matrix;                                                                    \
    int first_ = from; /* may be of the caller's variables */                                \
    for (MINE(n_, e_)) array[first_ + e_ / TN * (stride) + e_ % TN] = stored.at[n_];         \
  }

Sums zeros() {
  Sums c;
  for (int n = 0; n < 64; ++n) c.at[n] = 0.0;
  return c;
}
#define ZERO zeros()
Sums joined(Sums c, Sums d, float factor) {
  for (int n = 0; n < 64; ++n) c.at[n] += d.at[n] * factor;
  return c;
}
#define JOIN(c, d, factor) joined(c, d, factor)
Sums multiply_add(Place a, Place b, Sums c);
#define MULTIPLY_ADD(a, b, c) multiply_add(a, b, c)
#include "convolution/conv_cooperative.glsl"

Sums multiply_add(Place a, Place b, Sums c) {
  for (MINE(n, i)) {
    int row = a.at + i / TN * a.stride, column = b.at + i % TN / 4;
    [[unroll]] for (int four = 0; four < TK / 4; ++four) {
      vec4 x = singles(a.low ? patch_low[row + four] : patch_high[row + four]);
      [[unroll]] for (int k = 0; k < 4; ++k) {
        int at = column + (4 * four + k) * b.stride;
        c.at[n] += x[k] * singles(b.low ? taps_low[at] : taps_high[at])[i % 4];
      }
    }
  }
  return c;
}
