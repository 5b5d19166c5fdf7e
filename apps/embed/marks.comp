#version 450
// Draws the features of an alignment into the application's image, straight from the result buffer of the recording: a line
// from each feature's place in the reference to where the pose found puts it, a cross there (green; red unless the alignment
// says that it converged), and a ring (magenta) where the true pose puts it.
// Groups: (features, 1).
#extension GL_GOOGLE_include_directive : require
#include "shared.h"
#include "refine/refine.h"
#include "marks_layout.glsl"
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba8) uniform writeonly image2D picture;
layout(set = 0, binding = 1, std430) readonly buffer Results { RefinedInfo result; };
layout(set = 0, binding = 2, std430) readonly buffer Points { FeatureInfo features[]; };
layout(push_constant) uniform Push { MarksPush push; };

const float CROSS = 4.0, RING = 8.0;  // half length and radius, in thicknesses

void put(vec2 at, vec3 colour) {
  ivec2 first = ivec2(round(at - 0.5 * float(push.thickness - 1u)));
  for (int i = 0; i < int(push.thickness * push.thickness); ++i) {
    ivec2 p = first + ivec2(i % int(push.thickness), i / int(push.thickness));
    if (all(greaterThanEqual(p, ivec2(0))) && all(lessThan(p, imageSize(picture)))) imageStore(picture, p, vec4(colour, 1.0));
  }
}

void cross_at(vec2 at, vec3 colour, int lane) {
  float size = CROSS * float(push.thickness);
  if (lane > 2 * int(size)) return;
  float along = float(lane) - size;
  put(at + vec2(along, 0.0), colour);
  put(at + vec2(0.0, along), colour);
}

// Pixel of camera 1; false behind it.
bool project(float pose[12], vec3 X, out vec2 uv) {
  vec3 Y = vec3(dot(vec3(pose[0], pose[1], pose[2]), X) + pose[3], dot(vec3(pose[4], pose[5], pose[6]), X) + pose[7],
                dot(vec3(pose[8], pose[9], pose[10]), X) + pose[11]);
  uv = vec2(push.fx, push.fy) * Y.xy / Y.z + vec2(push.cx, push.cy);
  return Y.z > 0.0;
}

void main() {
  FeatureInfo feature = features[gl_WorkGroupID.x];
  if (feature.inverse_depth == 0.0) return;  // none was found in its cell
  int lane = int(gl_LocalInvocationID.x);
  vec2 from = vec2(feature.u, feature.v), found, truth;
  vec3 green = vec3(0.0, 1.0, 0.0), red = vec3(1.0, 0.0, 0.0), magenta = vec3(1.0, 0.0, 1.0), yellow = vec3(1.0, 0.85, 0.2);
  if (push.target == 0u) {
    cross_at(from, green, lane);
    return;
  }
  vec3 X = vec3((from - vec2(push.cx, push.cy)) / vec2(push.fx, push.fy), 1.0) / feature.inverse_depth;
  bool has_found = project(result.pose, X, found), has_truth = project(push.true_pose, X, truth);
  if (has_found) {
    float size = distance(from, found);
    for (float s = float(lane); s < min(size, 1000.0); s += 64.0) put(mix(from, found, s / size), yellow);
  }
  barrier();  // marks over this feature's line
  float angle = 6.2831853 * float(lane) / 64.0;
  if (has_truth) put(truth + RING * float(push.thickness) * vec2(cos(angle), sin(angle)), magenta);
  if (has_found) cross_at(found, result.status == EMBED_CONVERGED ? green : red, lane);
}
