// The descriptor of 8x8 grey values: 16 coefficients of their cosine transform, of the lowest frequencies above 0. Each is
// multiplied by the fourth root of its squared frequency; then they are normalised. Brightness and contrast do not change it.
// The cosine of two descriptors is as distinctive as the correlation of all 64 values (docs/explain/start-search.md). Rows are
// added from above. Texel n: horizontal frequencies of vertical frequency n, 1 to 4 of 0 and 0 to 3 of 1 and 2; of 3: 0 to 2,
// then frequency 0 of 4.
#include "finite.glsl"

struct Descriptor {
  vec4 t0, t1, t2, t3;
};

// The transform of a row of eight values, a and b: frequencies 1 to 4 in `high`; frequency 0 is returned.
float row_transform(vec4 a, vec4 b, out vec4 high) {
  vec4 s = a + b.wzyx, d = a - b.wzyx;
  high.x = 0.5 * (0.98078528 * d.x + 0.83146961 * d.y + 0.55557023 * d.z + 0.19509032 * d.w);
  high.y = 0.5 * (0.92387953 * (s.x - s.w) + 0.38268343 * (s.y - s.z));
  high.z = 0.5 * (0.83146961 * d.x - 0.19509032 * d.y - 0.98078528 * d.z - 0.55557023 * d.w);
  high.w = 0.35355339 * (s.x - s.y - s.z + s.w);
  return 0.35355339 * (s.x + s.y + s.z + s.w);
}

// `c`: the weights of vertical frequencies 1 to 4 in this row.
void add_row(inout Descriptor d, vec4 a, vec4 b, vec4 c) {
  vec4 high;
  float mean = row_transform(a, b, high);
  vec4 low = vec4(mean, high.xyz);
  d.t0 += 0.35355339 * high;
  d.t1 += c.x * low;
  d.t2 += c.y * low;
  d.t3 += vec4(c.z * low.xyz, c.w * mean);
}

// FETCH_ROW(r, a, b) gives row r.
#define DESCRIBE(d)                                                                          \
  d = Descriptor(vec4(0.0), vec4(0.0), vec4(0.0), vec4(0.0));                                \
  {                                                                                          \
    vec4 a, b;                                                                               \
    FETCH_ROW(0, a, b) add_row(d, a, b, vec4(0.49039264, 0.46193977, 0.41573481, 0.35355339)); \
    FETCH_ROW(1, a, b) add_row(d, a, b, vec4(0.41573481, 0.19134172, -0.09754516, -0.35355339)); \
    FETCH_ROW(2, a, b) add_row(d, a, b, vec4(0.27778512, -0.19134172, -0.49039264, -0.35355339)); \
    FETCH_ROW(3, a, b) add_row(d, a, b, vec4(0.09754516, -0.46193977, -0.27778512, 0.35355339)); \
    FETCH_ROW(4, a, b) add_row(d, a, b, vec4(-0.09754516, -0.46193977, 0.27778512, 0.35355339)); \
    FETCH_ROW(5, a, b) add_row(d, a, b, vec4(-0.27778512, -0.19134172, 0.49039264, -0.35355339)); \
    FETCH_ROW(6, a, b) add_row(d, a, b, vec4(-0.41573481, 0.19134172, 0.09754516, -0.35355339)); \
    FETCH_ROW(7, a, b) add_row(d, a, b, vec4(-0.49039264, 0.46193977, -0.41573481, 0.35355339)); \
  }                                                                                          \
  normalise_descriptor(d);

void normalise_descriptor(inout Descriptor d) {
  d.t0 *= vec4(1.0, 1.41421356, 1.73205081, 2.0);
  d.t1 *= vec4(1.0, 1.18920712, 1.49534878, 1.77827941);
  d.t2 *= vec4(1.41421356, 1.49534878, 1.68179283, 1.89882892);
  d.t3 *= vec4(1.73205081, 1.77827941, 1.89882892, 2.0);
  float size = dot(d.t0, d.t0) + dot(d.t1, d.t1) + dot(d.t2, d.t2) + dot(d.t3, d.t3);
  bool textured = size >= ICLK_MATCH_LEAST * ICLK_MATCH_LEAST && is_finite(size) && size < 1e30;
  float scale = textured ? inversesqrt(size) : 0.0;
  d.t0 = textured ? d.t0 * scale : vec4(0.0);
  d.t1 = textured ? d.t1 * scale : vec4(0.0);
  d.t2 = textured ? d.t2 * scale : vec4(0.0);
  d.t3 = textured ? d.t3 * scale : vec4(0.0);
}
