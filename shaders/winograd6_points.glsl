// B^T of F(6, 3), interpolated at 0, +-A, +-B, +-C and infinity: eight texels in a line to the eight that are multiplied.
const float A = ICLK_WINOGRAD6_A, B = ICLK_WINOGRAD6_B, C = ICLK_WINOGRAD6_C, A2 = A * A, B2 = B * B, C2 = C * C;

// Those of the points x and -x; y and z are the squares of the other two.
void transform_pair(float x, float y, float z, vec4 odd[3], vec4 even[3], out vec4 plus, out vec4 minus) {
  vec4 p = even[2] - (y + z) * even[1] + (y * z) * even[0], q = x * (odd[2] - (y + z) * odd[1] + (y * z) * odd[0]);
  plus = p + q;
  minus = p - q;
}

void transform(inout vec4 a, inout vec4 b, inout vec4 c, inout vec4 d, inout vec4 e, inout vec4 f, inout vec4 g, inout vec4 h) {
  vec4 odd[3] = vec4[3](b, d, f), even[3] = vec4[3](c, e, g);
  a = g - (A2 + B2 + C2) * e + (A2 * B2 + A2 * C2 + B2 * C2) * c - A2 * B2 * C2 * a;
  h = h - (A2 + B2 + C2) * f + (A2 * B2 + A2 * C2 + B2 * C2) * d - A2 * B2 * C2 * b;
  transform_pair(A, B2, C2, odd, even, b, c);
  transform_pair(B, A2, C2, odd, even, d, e);
  transform_pair(C, A2, B2, odd, even, f, g);
}
