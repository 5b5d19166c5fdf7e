// The ray of a pixel through a lens; align/lens.cpp has the same in double precision. Needs LENS and RenderPush push. radtan
// and equidistant share the radial polynomial f(r) = r (1 + k0 r^2 + k1 r^4 + k2 r^6 + k3 r^8), of a radius or an angle.
const int LENS_RADIAL_ITERATIONS = 10, LENS_ITERATIONS = 5;
const float LENS_EXACT = 2e-6;  // of focal length 1

float lens_value(float r) {
  float q = r * r;
  return r * (1.0 + q * (push.lens[4] + q * (push.lens[5] + q * (push.lens[6] + q * push.lens[7]))));
}

float lens_slope(float r) {
  float q = r * r;
  return 1.0 + q * (3.0 * push.lens[4] + q * (5.0 * push.lens[5] + q * (7.0 * push.lens[6] + q * 9.0 * push.lens[7])));
}

// The inverse of f in 0 .. limit, or the nearer end.
float lens_inverse(float seen) {
  float low = 0.0, high = push.ray_0[0], r = min(seen, high);
  for (int i = 0; i < LENS_RADIAL_ITERATIONS; ++i) {
    float error = lens_value(r) - seen;
    if (error > 0.0)
      high = r;
    else
      low = r;
    float next = r - error / lens_slope(r);
    r = next >= low && next <= high ? next : 0.5 * (low + high);
  }
  return r;
}

// The image position of the ray (x, y, 1) for radtan, and its Jacobian.
vec2 radtan(vec2 xy, out mat2 jacobian) {
  float q = dot(xy, xy), p1 = push.ray_0[1], p2 = push.ray_0[2];
  float scale = 1.0 + q * (push.lens[4] + q * (push.lens[5] + q * push.lens[6]));
  float change = 2.0 * (push.lens[4] + q * (2.0 * push.lens[5] + q * 3.0 * push.lens[6]));
  float mixed = change * xy.x * xy.y + 2.0 * (p1 * xy.x + p2 * xy.y);
  jacobian = mat2(scale + change * xy.x * xy.x + 2.0 * p1 * xy.y + 6.0 * p2 * xy.x, mixed,  //
                  mixed, scale + change * xy.y * xy.y + 6.0 * p1 * xy.y + 2.0 * p2 * xy.x);
  return xy * scale + vec2(2.0 * p1 * xy.x * xy.y + p2 * (q + 2.0 * xy.x * xy.x),
                           p1 * (q + 2.0 * xy.y * xy.y) + 2.0 * p2 * xy.x * xy.y);
}

// Computes the ray (x, y, 1) at the image position `distorted`, and its Jacobian. Returns false outside the model's domain.
bool undistort(vec2 distorted, out vec2 xy, out mat2 change) {
  float seen = length(distorted), r = lens_inverse(seen);
  vec2 n = seen > 0.0 ? distorted / seen : vec2(1.0, 0.0);
  if (LENS == ICLK_LENS_EQUIDISTANT) {
    float t = tan(r), along = (1.0 + t * t) / lens_slope(r), across = seen > 1e-12 ? t / seen : 1.0;
    xy = n * t;
    change = mat2(across + (along - across) * n.x * n.x, (along - across) * n.x * n.y,  //
                  (along - across) * n.x * n.y, across + (along - across) * n.y * n.y);
    return r < push.ray_0[0] && abs(lens_value(r) - seen) < LENS_EXACT;
  }
  xy = n * r;
  mat2 jacobian;
  for (int i = 0; i < LENS_ITERATIONS; ++i) {
    vec2 error = radtan(xy, jacobian) - distorted;
    xy -= inverse(jacobian) * error;
  }
  vec2 error = radtan(xy, jacobian) - distorted;
  change = inverse(jacobian);
  return length(error) < LENS_EXACT * (1.0 + seen) && length(xy) < push.ray_0[0] && determinant(jacobian) > 0.0;
}
