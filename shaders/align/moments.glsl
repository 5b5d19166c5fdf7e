// Correlation of f0 and the warped f1 over the weighted pixels of an accepted point, from the moments in its sums
// (align/solver/normal_equations.cpp). Needs shared.h and the binding states[]. 0 where either image is constant.
float correlation_of(uint pair) {
  // f1 = r + a f0 + b
  float a = states[pair].accepted_gain, b = states[pair].accepted_bias;
  float n = states[pair].sums[4 * 11 + 3], s0 = states[pair].sums[4 * 10 + 3];
  float s00 = states[pair].sums[4 * 10 + 2], s0r = states[pair].sums[4 * 13 + 2], sr = states[pair].sums[4 * 13 + 3];
  float s1 = sr + a * s0 + b * n, s01 = s0r + a * s00 + b * s0;
  float s11 = states[pair].sums[4 * 14] + 2.0 * (a * s0r + b * sr) + a * a * s00 + 2.0 * a * b * s0 + b * b * n;
  float m1 = states[pair].sums[4 * 14] + 2.0 * (abs(a * s0r) + abs(b * sr)) + a * a * s00 + 2.0 * abs(a * b * s0) + b * b * n;
  float v0 = s00 - s0 * s0 / n, v1 = s11 - s1 * s1 / n;
  bool textured = n > 0.0 && v0 > ICLK_LEAST_SPREAD * s00 && v1 > ICLK_LEAST_SPREAD * m1;
  return textured ? clamp((s01 - s0 * s1 / n) * inversesqrt(v0 * v1), -1.0, 1.0) : 0.0;
}
