// Test kernel: out[i] = factor * (in[i] + texel[i]) + offset, for i < count. Spec constant 0: workgroup size, 1: factor.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "texels.glsl"
layout(local_size_x_id = 0) in;
layout(constant_id = 1) const int factor = 1;
layout(set = 0, binding = 0, std430) readonly buffer In { int values[]; } source;
TEXELS(1, float, texels)
layout(set = 0, binding = 2, std430) writeonly buffer Out { int values[]; } result;
layout(push_constant) uniform Push { int offset; uint count; } push;

void main() {
  const uint i = gl_GlobalInvocationID.x;
  if (i < push.count) result.values[i] = factor * (source.values[i] + int(TEXEL(texels, int(i)).x)) + push.offset;
}
