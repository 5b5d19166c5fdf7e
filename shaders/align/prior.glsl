// A Gaussian prior on the pose (align/solver/lm.cpp). Needs shared.h and se3.glsl.
struct Prior {
  float H[36];
  float g[6];
  float objective;
};

// e = Log(mean^-1 T), e(T Exp(xi)^-1) = e - J_r^-1(e) xi, J_r^-1 = I + ad/2 + ad^2/12.
Prior prior_of(Pose mean, float information[36], Pose pose) {
  Prior p;
  vec3 rho, phi;
  se3_log(compose(inverse_pose(mean), pose), rho, phi);
  mat3 P = hat(rho), W = hat(phi);
  mat3 A = mat3(1.0) + 0.5 * W + W * W / 12.0;
  mat3 B = 0.5 * P + (W * P + P * W) / 12.0;
  float e[6] = float[6](rho.x, rho.y, rho.z, phi.x, phi.y, phi.z);
  float J[36], L[36];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      J[6 * i + j] = A[j][i];
      J[6 * i + j + 3] = B[j][i];
      J[6 * (i + 3) + j] = 0.0;
      J[6 * (i + 3) + j + 3] = A[j][i];
    }
  p.objective = 0.0;
  for (int i = 0; i < 6; ++i) {  // L = J^T information
    for (int j = 0; j < 6; ++j) {
      float s = 0.0;
      for (int k = 0; k < 6; ++k) s += J[6 * k + i] * information[6 * k + j];
      L[6 * i + j] = s;
    }
    float s = 0.0;
    for (int k = 0; k < 6; ++k) s += information[6 * i + k] * e[k];
    p.objective += e[i] * s;
  }
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) {
      float s = 0.0;
      for (int k = 0; k < 6; ++k) s += L[6 * i + k] * J[6 * k + j];
      p.H[6 * i + j] = s;
    }
    float s = 0.0;
    for (int k = 0; k < 6; ++k) s += L[6 * i + k] * e[k];
    p.g[i] = s;
  }
  return p;
}
