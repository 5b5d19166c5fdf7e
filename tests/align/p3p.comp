// Test kernel: the poses of shaders/search/p3p.glsl for triples of points and rays, 6 vec4 each; out: the count, then four
// poses of three rows (R, t). Specialisation constant 0: workgroup size.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "shared.h"
layout(local_size_x_id = 0) in;
layout(set = 0, binding = 0, std430) readonly buffer Triples { vec4 triples[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Poses { vec4 poses[]; };
layout(push_constant) uniform Push { uint count; } push;
#include "se3.glsl"
#include "search/p3p.glsl"

void main() {
  uint n = gl_GlobalInvocationID.x;
  if (n >= push.count) return;
  vec3 x1 = triples[6u * n].xyz, x2 = triples[6u * n + 1u].xyz, x3 = triples[6u * n + 2u].xyz;
  vec3 y1 = triples[6u * n + 3u].xyz, y2 = triples[6u * n + 4u].xyz, y3 = triples[6u * n + 5u].xyz;
  vec3 d12 = x1 - x2, d13 = x1 - x3, d23 = x2 - x3, distances[4];
  int solutions = p3p_distances(y1, y2, y3, dot(d12, d12), dot(d13, d13), dot(d23, d23), distances);
  poses[13u * n] = vec4(float(solutions), 0.0, 0.0, 0.0);
  for (int s = 0; s < solutions; ++s) {
    Pose T = pose_of_triangles(x1, x2, x3, distances[s].x * y1, distances[s].y * y2, distances[s].z * y3);
    for (int r = 0; r < 3; ++r) poses[13u * n + 3u * uint(s) + uint(r) + 1u] = vec4(T.R[0][r], T.R[1][r], T.R[2][r], T.t[r]);
  }
}
