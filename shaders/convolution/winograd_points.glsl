// B^T of F(4, 3), interpolated at 0, +-A, +-B and infinity. It transforms six adjacent texels to the six factors.
const float A = ICLK_WINOGRAD_A, B = ICLK_WINOGRAD_B, A2 = A * A, B2 = B * B;

void transform(inout vec4 a, inout vec4 b, inout vec4 c, inout vec4 d, inout vec4 e, inout vec4 f) {
  vec4 p = e - B2 * c, q = A * (d - B2 * b), r = e - A2 * c, s = B * (d - A2 * b);
  a = A2 * B2 * a - (A2 + B2) * c + e;
  f = A2 * B2 * b - (A2 + B2) * d + f;
  b = p + q;
  c = p - q;
  d = r + s;
  e = r - s;
}
