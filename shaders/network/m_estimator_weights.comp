#version 460
// The end of the M-estimator: the sigmoid of its last layer times the mask of visible pixels. It is written to the weights of
// the elements, and to the map that the next finer level reads. Groups: (ceil(64 patches / local size), 1, 1).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "texels.glsl"
#include "network/network.h"
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint LANES = 8;  // of a workgroup of the sums
layout(set = 0, binding = 0, std430) readonly buffer Levels { LevelInfo levels[]; };
layout(set = 0, binding = 1, std430) readonly buffer Pairs { PairInfo pairs[]; };
layout(set = 0, binding = 2, std430) readonly buffer FeatureList { vec4 features[]; };
TEXELS(3, vec4, activations)
layout(set = 0, binding = 4, std430) readonly buffer Residuals { float residuals[]; };
layout(set = 0, binding = 5, std430) writeonly buffer Weights { float weights[]; };
layout(set = 0, binding = 6, std430) writeonly buffer Prior { float prior[]; };
layout(push_constant) uniform Push { MEstimatorPush push; };
#include "network/patch_corner.glsl"

void main() {
  uint id = gl_GlobalInvocationID.x, patch_index = id / ICLK_PATCH_AREA, pixel = id % ICLK_PATCH_AREA;
  if (patch_index >= push.patches) return;
  uint number = push.first_patch + patch_index, pass_pair = number / push.patches_per_pair;
  uint pair = push.first_pair + pass_pair;
  if (pairs[pair].enabled == 0u) return;
  LevelInfo info = levels[push.level];
  uint patch_of_pair = number - pass_pair * push.patches_per_pair, k = patch_of_pair * ICLK_PATCH_AREA + pixel;
  ivec2 place = patch_corner(pair, patch_of_pair, info) + ivec2(pixel % ICLK_PATCH, pixel / ICLK_PATCH);
  bool inside = place.x >= 0 && place.y >= 0 && place.x < int(info.width) && place.y < int(info.height);
  if (push.dense != 0u) {
    if (!inside) return;
    k = uint(place.y) * info.width + uint(place.x);
  }
  uint element = pair * push.weight_stride + k;
  bool visible = inside && abs(residuals[element]) < 1e38;
  uint at = id;
  if (push.whole != 0u) {
    uint piece = pass_pair - push.first_patch / push.patches_per_pair;
    at = inside ? (piece * info.height + uint(place.y)) * info.width + uint(place.x) : 0u;
  }
  float x = TEXEL(activations, int(at)).x;
  float weight = visible ? 1.0 / (1.0 + exp(-x)) : 0.0;
  // Four elements of a lane are adjacent there: weights.glsl.
  uint block = k / (4u * LANES) * (4u * LANES), in_block = k - block;
  weights[pair * push.weight_stride + block + 4u * (in_block % LANES) + in_block / LANES] = weight;
  if (visible && push.level > 0u)
    prior[pair * push.prior_stride + info.map_offset - push.prior_origin + uint(place.y) * info.pitch + uint(place.x)] = weight;
}
