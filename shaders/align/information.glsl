// H of the pose at a pair's accepted point: its columns are multiplied by the gain, and gain and bias are marginalised out
// (align/solver/lm.cpp: pose_information). Needs shared.h and the binding states[].

float sum8(uint pair, uint i, uint j) {
  uint lo = min(i, j), hi = max(i, j);
  return states[pair].sums[hi < 4u ? 4u * lo + hi : (lo < 4u ? 16u + 4u * lo : 32u + 4u * (lo - 4u)) + hi - 4u];
}

// Entry i, j; `own`: before gain and bias are marginalised out.
float pose_information(uint pair, bool photometric, uint i, uint j, out float own) {
  float a = states[pair].accepted_gain;
  float c00 = sum8(pair, 6u, 6u), c01 = sum8(pair, 6u, 7u), c11 = sum8(pair, 7u, 7u), det = c00 * c11 - c01 * c01;
  own = a * a * sum8(pair, i, j);
  if (!photometric || abs(det) <= 1e-12 * c00 * c11) return own;
  float f0 = sum8(pair, i, 6u), f1 = sum8(pair, i, 7u), g0 = sum8(pair, j, 6u), g1 = sum8(pair, j, 7u);
  return own - a * a * (f0 * (c11 * g0 - c01 * g1) + f1 * (c00 * g1 - c01 * g0)) / det;
}
