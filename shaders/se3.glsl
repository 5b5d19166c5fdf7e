// SE(3) in single precision, conventions of align/se3.h: a pose is R | t, a twist [rho, phi].
struct Pose {
  mat3 R;  // GLSL columns: R[c][r]
  vec3 t;
};

// Twelve floats of a buffer, 3x4 row-major.
Pose pose_of(float m[12]) {
  return Pose(mat3(m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10]), vec3(m[3], m[7], m[11]));
}

mat3 hat(vec3 w) { return mat3(0.0, w.z, -w.y, -w.z, 0.0, w.x, w.y, -w.x, 0.0); }

Pose se3_exp(vec3 rho, vec3 phi) {
  float theta2 = dot(phi, phi);
  float theta = sqrt(theta2);
  // Below 1e-2 rad^2 the series are exact to single precision; the closed forms cancel there.
  bool small_angle = theta2 < 1e-2;
  float safe = small_angle ? 1.0 : theta;
  float half_sine = sin(0.5 * safe);
  float a = small_angle ? 1.0 - theta2 * (1.0 / 6.0 - theta2 * (1.0 / 120.0 - theta2 / 5040.0)) : sin(safe) / safe;
  float b = small_angle ? 0.5 - theta2 * (1.0 / 24.0 - theta2 * (1.0 / 720.0 - theta2 / 40320.0))
                        : 2.0 * half_sine * half_sine / (safe * safe);
  float c = small_angle ? 1.0 / 6.0 - theta2 * (1.0 / 120.0 - theta2 * (1.0 / 5040.0 - theta2 / 362880.0))
                        : (safe - sin(safe)) / (safe * safe * safe);
  mat3 W = hat(phi);
  mat3 W2 = W * W;
  return Pose(mat3(1.0) + a * W + b * W2, rho + b * (W * rho) + c * (W2 * rho));
}

// Log of a rotation of less than about 2.5 rad, such as the difference between a prior and the pose.
void se3_log(Pose T, out vec3 rho, out vec3 phi) {
  vec3 w = 0.5 * vec3(T.R[1][2] - T.R[2][1], T.R[2][0] - T.R[0][2], T.R[0][1] - T.R[1][0]);  // sin(theta) axis
  float s = length(w);
  float c = 0.5 * (T.R[0][0] + T.R[1][1] + T.R[2][2] - 1.0);
  float theta = atan(s, c);
  phi = s < 1e-6 ? w : w * (theta / s);
  float theta2 = theta * theta;
  float k = theta2 < 1e-3 ? 1.0 / 12.0 + theta2 / 720.0 : (1.0 - 0.5 * theta / tan(0.5 * theta)) / theta2;
  mat3 W = hat(phi);
  rho = T.t - 0.5 * (W * T.t) + k * (W * (W * T.t));
}

Pose compose(Pose a, Pose b) { return Pose(a.R * b.R, a.R * b.t + a.t); }

Pose inverse_pose(Pose a) {
  mat3 Rt = transpose(a.R);
  return Pose(Rt, -(Rt * a.t));
}

// One Newton step towards the nearest rotation, to remove the rounding errors of many products.
mat3 orthonormalized(mat3 R) { return R * (1.5 * mat3(1.0) - 0.5 * (transpose(R) * R)); }
