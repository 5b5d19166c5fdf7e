// Functions for refine_pose, refine_turn and refine_verdict: one workgroup per pair, with its features strided over the
// invocations. refine/internal/reprojection.cpp has the same in double precision. Every invocation has the same pose and sums,
// so branches on them are uniform and may contain barriers.
#include "shared.h"
#include "refine/refine.h"
#include "se3.glsl"
#include "refine/warp.glsl"
layout(local_size_x = ICLK_REFINE_GROUP) in;

layout(set = 0, binding = 0, std430) readonly buffer References { ReferenceInfo references[]; };
layout(set = 0, binding = 1, std430) readonly buffer Pairs { RefinePair pairs[]; };
layout(set = 0, binding = 2, std430) readonly buffer FeatureList { FeatureInfo features[]; };
layout(set = 0, binding = 3, std430) readonly buffer Aligned { AlignedInfo aligned[]; };
#ifdef ICLK_LISTS_OBSERVATIONS
layout(set = 0, binding = 4, std430) coherent buffer Observations { ObservationInfo observations[]; };
#else
layout(set = 0, binding = 4, std430) buffer Observations { ObservationInfo observations[]; };
#endif
layout(set = 0, binding = 5, std430) buffer States { RefineState states[]; };
#ifdef ICLK_FINDS_TURNS
layout(set = 0, binding = 6, std430) buffer Turns { TurnInfo turns[]; };
#else
layout(set = 0, binding = 6, std430) readonly buffer Turns { TurnInfo turns[]; };
#endif
layout(push_constant) uniform Push { RefinePush push; };

const uint ALIGNED = 0, LOW_TEXTURE = 3, HIDDEN = 6;                                                   // FeatureStatus
const uint CONVERGED = 0, MAX_ITERATIONS = 1, DEGENERATE = 3, TOO_FEW_FEATURES = 4, DIVERGED = 5;      // Status
const float INFINITE = 3.0e38;

uint lane;
RefinePair pair;
ReferenceInfo reference;
vec3 turn;  // of the target while its rows were read

#define EACH_FEATURE(i) for (uint i = pair.first_feature + lane; i < pair.first_feature + pair.feature_count; \
                             i += ICLK_REFINE_GROUP)

void begin(uint index) {
  lane = gl_LocalInvocationID.x;
  pair = pairs[index];
  reference = references[pair.reference];
  turn = vec3(turns[index].turn[0], turns[index].turn[1], turns[index].turn[2]);
  if (pair.unit == 0.0) pair.unit = reference.mean_inverse_depth > 0.0 ? reference.mean_inverse_depth : 1.0;
}

// A feature in the unit of the pair.
FeatureInfo feature_at(uint i) {
  FeatureInfo f = features[i];
  f.inverse_depth /= pair.unit;
  return f;
}

// row_time() of refine/rolling_shutter.h.
float row_time(float v) { return (v + 0.5) / float(push.height) - 0.5; }

mat3 turned_by(vec3 phi) { return se3_exp(vec3(0.0), phi).R; }

// The position of an aligned feature, corrected to a global shutter: unrolled().
vec2 position_of(uint i) {
  vec2 uv = vec2(aligned[i].u, aligned[i].v);
  if (turn == vec3(0.0)) return uv;
  vec2 focal = vec2(reference.fx, reference.fy), principal = vec2(reference.cx, reference.cy);
  vec3 p = turned_by(turn * row_time(uv.y)) * vec3((uv - principal) / focal, 1.0);
  return p.xy / p.z * focal + principal;
}

Pose scaled(Pose T, float unit) { return Pose(T.R, T.t * unit); }

float[12] floats_of(Pose T) {
  return float[12](T.R[0][0], T.R[1][0], T.R[2][0], T.t.x, T.R[0][1], T.R[1][1], T.R[2][1], T.t.y, T.R[0][2], T.R[1][2],
                   T.R[2][2], T.t.z);
}

// A feature seen from camera 1: p = R ray + q t, and rows k of du1 / dp.
struct Projection {
  vec3 ray, p;
  vec2 uv1;
  vec3 du, dv;
  bool in_front;
};

Projection project(FeatureInfo f, Pose T) {
  Projection x;
  vec2 focal = vec2(reference.fx, reference.fy);
  x.ray = vec3((vec2(f.u, f.v) - vec2(reference.cx, reference.cy)) / focal, 1.0);
  x.p = T.R * x.ray + f.inverse_depth * T.t;
  x.in_front = x.p.z > ICLK_LEAST_DEPTH;
  float z = x.in_front ? x.p.z : 1.0;
  x.uv1 = x.p.xy / z * focal + vec2(reference.cx, reference.cy);
  x.du = vec3(focal.x, 0.0, -focal.x * x.p.x / z) / z;
  x.dv = vec3(0.0, focal.y, -focal.y * x.p.y / z) / z;
  return x;
}

// du1 / dxi of T Exp(xi), a row each for u and v; six numbers.
struct Rows {
  float u[6], v[6];
};

Rows jacobian(Projection x, float q, Pose T) {
  vec3 a = x.du * T.R, b = x.dv * T.R;
  vec3 c = cross(x.ray, a), d = cross(x.ray, b);
  a *= q;
  b *= q;
  return Rows(float[6](a.x, a.y, a.z, c.x, c.y, c.z), float[6](b.x, b.y, b.z, d.x, d.y, d.z));
}

// q du1 / dq, px: the motion per relative error of the inverse depth.
vec2 along_epipolar(Projection x, float q, Pose T) { return q * vec2(dot(x.du, T.t), dot(x.dv, T.t)); }

// sigma_0 (C + sigma_0^2 I)^-1/2; C and the result as (uu, uv, vv).
vec3 whitening(vec3 C, float sigma) {
  C.xz += sigma * sigma;
  float root = sqrt(max(C.x * C.z - C.y * C.y, 0.0));
  return sigma / (root * sqrt(C.x + C.z + 2.0 * root)) * vec3(C.z + root, -C.y, C.x + root);
}

vec3 W_of(uint i) { return vec3(observations[i].W_uu, observations[i].W_uv, observations[i].W_vv); }

vec2 whitened(vec3 W, vec2 r) { return vec2(W.x * r.x + W.y * r.y, W.y * r.x + W.z * r.y); }

Rows whitened(vec3 W, Rows J) {
  Rows w;
  [[unroll]] for (int k = 0; k < 6; ++k) {
    w.u[k] = W.x * J.u[k] + W.y * J.v[k];
    w.v[k] = W.y * J.u[k] + W.z * J.v[k];
  }
  return w;
}

// Squared norm of the whitened residual, infinite behind the camera; r: the residual itself.
float square_of(uint i, Projection x, out vec2 r) {
  r = x.uv1 - position_of(i);
  vec2 w = whitened(W_of(i), r);
  return x.in_front ? dot(w, w) : INFINITE;
}

// Whether the pose projects a feature to within `distance` px of its aligned position.
bool is_near(uint i, Pose T, float distance) {
  Projection x = project(feature_at(i), T);
  return x.in_front && length(x.uv1 - position_of(i)) <= distance;
}

// --- sums over the workgroup ---

#define SUMS 28
shared float partial[ICLK_REFINE_GROUP * SUMS], totals[SUMS];

// s becomes its sum over the invocations, in their order.
void sum(inout float s[SUMS]) {
  [[unroll]] for (int k = 0; k < SUMS; ++k) partial[lane * SUMS + k] = s[k];
  barrier();
  if (lane < SUMS) {
    float t = 0.0;
    for (uint i = 0; i < ICLK_REFINE_GROUP; ++i) t += partial[i * SUMS + lane];
    totals[lane] = t;
  }
  barrier();
  [[unroll]] for (int k = 0; k < SUMS; ++k) s[k] = totals[k];
}

// Upper triangle of the symmetric 6x6 matrix that sums begin with.
#define TRIANGLE(i, j) ((i) * 6 - (i) * ((i) - 1) / 2 + (j) - (i))

void add_products(inout float s[SUMS], float w, float a[6], float b[6]) {
  [[unroll]] for (int i = 0; i < 6; ++i)
    [[unroll]] for (int j = i; j < 6; ++j) s[TRIANGLE(i, j)] += w * a[i] * b[j];
}

void clear(out float s[SUMS]) {
  [[unroll]] for (int k = 0; k < SUMS; ++k) s[k] = 0.0;
}
