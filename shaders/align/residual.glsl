// Residual of one element (align/solver/normal_equations.h: residuals). Needs level.glsl, se3.glsl and the bindings
//   template_a, template_b, maps1 (texels.glsl) of the including shader.

// false: this aligner never uses weights. A flag is not enough, because lavapipe runs both sides of a branch.
layout(constant_id = 3) const bool WEIGHTED = true;

// Pixels of targets can be hidden.
layout(constant_id = 5) const bool MASKED = false;

// The data that all elements of a pair share.
struct View {
  LevelCamera camera;
  Pose pose;
  float gain, bias;
  int template_base, map_base, pitch;
  uint weight_base;  // vec4
  bool unit_weights;
};

// The four texels of f1 around warp(u), as (left, right) of the rows above and below, and the position between them. visible =
// in front of camera 1, inside the image and not hidden; p = the point in camera 1, times its inverse depth in camera 0.
void target_at(View view, vec4 a, out vec2 top, out vec2 bottom, out vec2 f, out vec3 p, out bool visible) {
  vec2 focal = vec2(view.camera.fx, view.camera.fy), principal = vec2(view.camera.cx, view.camera.cy);
  vec3 ray = vec3((a.xy - principal) / focal, 1.0);
  // Computes the motion of the pixel, not its new position. Without motion the position is then exact for every rounding of the
  // device, and pixels at the border are not lost.
  mat3 turn = view.pose.R - mat3(1.0);
  vec3 moved = turn * ray + a.z * view.pose.t;
  p = ray + moved;
  vec2 w = a.xy + (moved.xy - moved.z * ray.xy) * focal / p.z;
  vec2 last = vec2(view.camera.last_u, view.camera.last_v);
  visible = a.z > 0.0 && p.z > ICLK_LEAST_DEPTH && w.x >= 0.0 && w.y >= 0.0 && w.x <= last.x && w.y <= last.y;
  // An invisible pixel reads a valid address; its value is not used.
  w = visible ? w : vec2(0.0);
  vec2 corner = min(floor(w), last - 1.0);
  f = w - corner;
  int at = view.map_base + int(corner.y) * view.pitch + int(corner.x);
  top = vec2(TEXEL(maps1, at).x, TEXEL(maps1, at + 1).x);
  bottom = vec2(TEXEL(maps1, at + view.pitch).x, TEXEL(maps1, at + view.pitch + 1).x);
  if (MASKED) {
    visible = visible && max(max(top.x, top.y), max(bottom.x, bottom.y)) <= ICLK_HIDDEN_FROM;
    top = visible ? top : vec2(0.0);  // hidden values would overflow in sums
    bottom = visible ? bottom : vec2(0.0);
  }
}

// f1(warp(u)) - (gain f0 + bias)
float residual_at(View view, vec4 a, out bool visible) {
  vec2 top, bottom, f;
  vec3 p;
  target_at(view, a, top, bottom, f, p, visible);
  vec2 left_right = mix(top, bottom, f.y);
  return mix(left_right.x, left_right.y, f.x) - (view.gain * a.w + view.bias);
}

// |r| of the elements k, k + L, k + 2 L and k + 3 L; see weights.glsl.
vec4 magnitudes_at(View view, uint k, uint end) {
  vec4 m = vec4(0.0);
  for (uint j = 0u; j < 4u; ++j, k += gl_WorkGroupSize.x) {
    bool visible;
    float r = residual_at(view, TEXEL(template_a, view.template_base + int(min(k, end - 1u))), visible);
    m = vec4(m.yzw, visible && k < end ? abs(r) : 3e38);
  }
  return m;
}
