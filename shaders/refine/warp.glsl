#include "finite.glsl"
// The affine warp of a feature's patch: warp_patch() of refine/internal/align_feature.h.
struct PatchWarp {
  vec2 uv1;        // 0 behind the camera
  mat2 A_inverse;  // du0 / du1
  bool valid;
};

PatchWarp warp_patch(FeatureInfo feature, ReferenceInfo r, Pose T_10) {
  PatchWarp w;
  w.uv1 = vec2(0.0);
  w.valid = false;
  vec2 focal = vec2(r.fx, r.fy), principal = vec2(r.cx, r.cy), uv0 = vec2(feature.u, feature.v);
  vec3 p = T_10.R * vec3((uv0 - principal) / focal, 1.0) + feature.inverse_depth * T_10.t;
  if (!(p.z > ICLK_LEAST_DEPTH)) return w;
  w.uv1 = p.xy / p.z * focal + principal;
  // A = d(u1)/d(ray) d(ray)/d(u0), by columns.
  vec3 X = T_10.R[0] / focal.x, Y = T_10.R[1] / focal.y;
  mat2 A = mat2((X.xy - p.xy * (X.z / p.z)) / p.z * focal, (Y.xy - p.xy * (Y.z / p.z)) / p.z * focal);
  float det = determinant(A);
  w.valid = det > 1.0 / 16.0 && det < 16.0 && is_finite(w.uv1.x) && is_finite(w.uv1.y);
  w.A_inverse = mat2(A[1].y, -A[0].y, -A[1].x, A[0].x) / det;
  return w;
}
