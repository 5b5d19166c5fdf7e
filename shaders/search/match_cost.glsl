// The cost of a pose for a pair's correspondences (correspond.comp). Needs shared.h, se3.glsl and `correspondences`.
struct MatchView {
  int header, count;
  float repeats;  // share of the features that look the same elsewhere
  vec4 camera;  // fx, fy, cx, cy
  float tolerance;
};

MatchView match_view(uint pair, ReferenceInfo r) {
  int header = int(2u * pair * (push.features + 1u));
  vec4 of_pair = TEXEL(correspondences, header);
  return MatchView(header, int(of_pair.x), of_pair.y, vec4(r.fx, r.fy, r.cx, r.cy),
                   ICLK_MATCH_TOLERANCE * float(push.scale));
}

vec4 point_of(MatchView view, int k) { return TEXEL(correspondences, view.header + 2 * (k + 1)); }
vec2 pixel_of(MatchView view, int k) { return TEXEL(correspondences, view.header + 2 * (k + 1) + 1).xy; }

// Pixel minus projection; very large for points behind the camera.
vec2 match_residual(MatchView view, Pose T, int k, out vec3 seen) {
  seen = T.R * point_of(view, k).xyz + T.t;
  bool ahead = seen.z > ICLK_LEAST_DEPTH;
  vec2 at = view.camera.xy * seen.xy / (ahead ? seen.z : 1.0) + view.camera.zw;
  return ahead ? pixel_of(view, k) - at : vec2(1e9);
}

// The sum of squared residuals in units of the tolerance, each at most 1.
float match_cost(MatchView view, Pose T, out int inliers) {
  float cost = 0.0, scale = 1.0 / (view.tolerance * view.tolerance);
  inliers = 0;
  for (int k = 0; k < view.count; ++k) {
    vec3 seen;
    vec2 r = match_residual(view, T, k, seen);
    float e = dot(r, r) * scale;
    bool near = e < 1.0;  // false for NaN
    cost += near ? e : 1.0;
    inliers += near ? 1 : 0;
  }
  return cost;
}
