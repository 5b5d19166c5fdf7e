#version 460
// The colour sums of aligned patches, for the grey values that fit the reference (refine/internal/recolour.h).
// refine/internal/align_feature.cpp has the same in double precision: colour_sums().
// Inputs: those of feature_alignment.comp, its results, and the targets' raw pixels. Output: one ColourInfo per feature, zero
// unless it is aligned and its task requests it.
// Groups: (features, tasks). Branches are uniform in a group.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "refine/feature_patch.glsl"
#define PIXELS_BINDING 9
#include "pixels.glsl"
layout(set = 0, binding = 8, std430) readonly buffer Aligned { AlignedInfo aligned[]; };
layout(set = 0, binding = 10, std430) writeonly buffer Colours { ColourInfo colours[]; };

// Sums over the patch without the products of its means.
ColourInfo colour_sums(uint index, FeatureTask task) {
  FeatureInfo feature = features[index];
  MapView f0 = map_view(task.reference, 0), f1 = map_view(task.pair, 0);
  mat2 A_inverse = warp_patch(feature, task).A_inverse;
  vec2 c0 = vec2(feature.u, feature.v), c1 = vec2(aligned[index].u, aligned[index].v);
  vec2 first = c1 - CENTRE;
  ivec2 corner = clamp(ivec2(first), ivec2(0), f1.last - ICLK_PATCH);  // as in feature alignment
  vec2 f = first - vec2(corner);
  uint base = task.pair * push.pixel_stride, at = uint((corner.y + row) * f1.pitch + corner.x);
  // Sums of differences from the values in the middle, because squares of the values are large compared to their differences.
  float middle_T = bilinear0(f0, c0);
  vec3 middle_C = colour(base, uint((corner.y + ICLK_PATCH / 2) * f1.pitch + corner.x + ICLK_PATCH / 2));
  vec3 blend[ICLK_PATCH + 1];
  [[unroll]] for (int i = 0; i <= ICLK_PATCH; ++i)
    blend[i] = mix(colour(base, at + uint(i)), colour(base, at + uint(f1.pitch + i)), f.y) - middle_C;
  vec4 C_T = vec4(0.0), TC_TT = vec4(0.0), CC = vec4(0.0), CC2 = vec4(0.0);
  [[unroll]] for (int i = 0; i < ICLK_PATCH; ++i) {
    float T = bilinear0(f0, c0 + A_inverse * (vec2(i, row) - CENTRE)) - middle_T;
    vec3 C = mix(blend[i], blend[i + 1], f.x);
    C_T += vec4(C, T);
    TC_TT += vec4(T * C, T * T);
    CC += vec4(C * C, C.x * C.y);
    CC2.xy += C.z * C.xy;
  }
  sum_rows(C_T, TC_TT);
  sum_rows(CC, CC2);
  float T = C_T.w;
  vec3 C = C_T.xyz;
  vec3 TC = TC_TT.xyz - T * C / AREA, squares = CC.xyz - C * C / AREA;
  vec3 products = vec3(CC.w, CC2.xy) - vec3(C.x * C.y, C.x * C.z, C.y * C.z) / AREA;
  return ColourInfo(TC_TT.w - T * T / AREA, float[3](TC.x, TC.y, TC.z),
                    float[6](squares.x, squares.y, squares.z, products.x, products.y, products.z));
}

void main() {
  row = int(gl_LocalInvocationID.x);
  FeatureTask task = tasks[gl_WorkGroupID.y];
  uint index = gl_WorkGroupID.x;
  if (index >= task.feature_count) return;
  index += task.first_feature;
  ColourInfo sums = ColourInfo(0.0, float[3](0.0, 0.0, 0.0), float[6](0.0, 0.0, 0.0, 0.0, 0.0, 0.0));
  if (task.colours != 0u && aligned[index].status == ALIGNED) sums = colour_sums(index, task);
  if (row == 0) colours[index] = sums;
}
