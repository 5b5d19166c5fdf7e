#version 460
// Cuts the M-estimator's input around each patch, as wide as its receptive field, with zeros outside the level. If the network
// processes whole levels, a "patch" is the level of a pair with the same border.
// Groups: (ceil(pixels of a patch / local size), n, m), n m >= patches.
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "texels.glsl"
#include "network/network.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer Pairs { PairInfo pairs[]; };
layout(set = 0, binding = 2, std430) readonly buffer FeatureList { vec4 features[]; };
TEXELS(3, vec2, residual_f0)
TEXELS(4, vec2, f1_prior)
layout(set = 0, binding = 5, std430) writeonly buffer Corners { ivec2 corners[]; };
layout(set = 0, binding = 6, std430) writeonly buffer Out { vec4 texels[]; };
layout(push_constant) uniform Push { MEstimatorPush push; };
#include "network/patch_corner.glsl"

void main() {
  uint patch_index = gl_WorkGroupID.z * gl_NumWorkGroups.y + gl_WorkGroupID.y, id = gl_GlobalInvocationID.x;
  LevelInfo info = levels[push.level];
  bool whole = push.whole != 0u;
  uint width = (whole ? info.width : ICLK_PATCH) + 2u * push.margin;
  uint height = (whole ? info.height : ICLK_PATCH) + 2u * push.margin;
  if (patch_index >= push.patches || id >= width * height) return;
  uint number = push.first_patch + patch_index, pass_pair = number / push.patches_per_pair;
  uint k = number - pass_pair * push.patches_per_pair;
  ivec2 corner = whole ? ivec2(0) : patch_corner(push.first_pair + pass_pair, k, info);
  if (id == 0u) corners[patch_index] = corner;
  ivec2 pixel = corner - int(push.margin) + ivec2(id % width, id / width);
  bool inside = pixel.x >= 0 && pixel.y >= 0 && pixel.x < int(info.width) && pixel.y < int(info.height);
  int at = int(pass_pair * push.inputs_stride) + pixel.y * int(info.width) + pixel.x;
  at = inside ? at : 0;
  vec4 value = vec4(TEXEL(residual_f0, at).xy, TEXEL(f1_prior, at).xy);
  texels[patch_index * width * height + id] = inside ? value : vec4(0.0);
}
