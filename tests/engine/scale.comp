// Test kernel: data[i] = 3 * data[i] + 1 in place, for i < count, after `spin` needless rounds so that a missing barrier shows.
#version 450
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) buffer Data { uint values[]; } data;
layout(push_constant) uniform Push { uint count; uint spin; } push;

void main() {
  const uint i = gl_GlobalInvocationID.x;
  if (i >= push.count) return;
  uint value = data.values[i];
  for (uint round = 0; round < push.spin; ++round) value = value * 5u + 1u;
  for (uint round = 0; round < push.spin; ++round) value = (value - 1u) * 0xcccccccdu;  // 1 / 5 modulo 2^32
  data.values[i] = 3u * value + 1u;
}
