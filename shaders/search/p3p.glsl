// The pose from three points and the rays that see them: Lambda Twist (Persson and Nordberg, ECCV 2018), the same steps as
// align/search/p3p.cpp in single precision. Up to four solutions; degenerate points have none, or ones that are not finite.
// Needs se3.glsl.
#include "finite.glsl"

// Roots of x^2 + b x + c.
vec2 square_roots(float b, float c) {
  float root = sqrt(max(0.25 * b * b - c, 0.0));
  float larger = b < 0.0 ? root - 0.5 * b : -root - 0.5 * b;
  return vec2(larger, larger != 0.0 ? c / larger : 0.0);
}

// The real root of x^3 + b x^2 + c x + d where the slope is steepest.
float cube_root(float b, float c, float d) {
  float q = (b * b - 3.0 * c) / 9.0, r = (2.0 * b * b * b - 9.0 * b * c + 27.0 * d) / 54.0, x;
  float q3 = q * q * q;
  if (r * r < q3) {
    float size = -2.0 * sqrt(q), angle = acos(clamp(r * inversesqrt(q3), -1.0, 1.0)) / 3.0;
    float least = size * cos(angle) - b / 3.0, most = size * cos(angle + 2.09439510) - b / 3.0;
    x = abs((3.0 * least + 2.0 * b) * least + c) > abs((3.0 * most + 2.0 * b) * most + c) ? least : most;
  } else {
    float a = pow(abs(r) + sqrt(max(r * r - q3, 0.0)), 1.0 / 3.0);
    a = r > 0.0 ? -a : a;
    x = a + (a != 0.0 ? q / a : 0.0) - b / 3.0;
  }
  [[unroll]] for (int i = 0; i < 3; ++i) {
    float slope = (3.0 * x + 2.0 * b) * x + c;
    x -= slope != 0.0 ? (((x + b) * x + c) * x + d) / slope : 0.0;
  }
  return x;
}

// Eigenvector of a symmetric matrix with a zero eigenvalue, M = (m00, m01, m02, m11, m12).
vec3 eigenvector(float e, float m00, float m01, float m02, float m11, float m12) {
  float scale = 1.0 / (e * (m00 + m11) - m00 * m11 - e * e + m01 * m01);
  vec2 a = -scale * vec2(e * m02 + m01 * m12 - m02 * m11, e * m12 + m01 * m02 - m00 * m12);
  return vec3(a, 1.0) * inversesqrt(dot(a, a) + 1.0);
}

// Computes the distances along unit rays y to points with squared distances a12, a13, a23. Returns the number of solutions.
int p3p_distances(vec3 y1, vec3 y2, vec3 y3, float a12, float a13, float a23, out vec3 solutions[4]) {
  float c12 = dot(y1, y2), c13 = dot(y1, y3), c23 = dot(y2, y3);
  float s12 = 1.0 - c12 * c12, s13 = 1.0 - c13 * c13, s23 = 1.0 - c23 * c23, blob = c12 * c23 * c13 - 1.0;
  float b12 = -2.0 * c12, b13 = -2.0 * c13, b23 = -2.0 * c23;
  float p3 = a13 * (a23 * s13 - a13 * s23);
  float p2 = 2.0 * blob * a23 * a13 + a13 * (2.0 * a12 + a13) * s23 + a23 * (a23 - a12) * s13;
  float p1 = a23 * (a13 - a23) * s12 - a12 * a12 * s23 - 2.0 * a12 * (blob * a23 + a13 * s23);
  float p0 = a12 * (a12 * s23 - a23 * s12);
  float g = cube_root(p2 / p3, p1 / p3, p0 / p3);

  float m00 = a23 * (1.0 - g), m01 = 0.5 * a23 * b12, m02 = -0.5 * a23 * b13 * g;
  float m11 = a23 - a12 + a13 * g, m12 = 0.5 * b23 * (a13 * g - a12), m22 = g * (a13 - a23) - a12;
  vec2 e = square_roots(-m00 - m11 - m22, m00 * (m11 + m22) + m11 * m22 - m01 * m01 - m02 * m02 - m12 * m12);
  if (abs(e.x) < abs(e.y)) e = e.yx;
  vec3 v1 = eigenvector(e.x, m00, m01, m02, m11, m12), v2 = eigenvector(e.y, m00, m01, m02, m11, m12);
  float sigma = sqrt(max(-e.y / e.x, 0.0));

  int count = 0;
  for (int twist = 0; twist < 2; ++twist) {
    float s = twist == 0 ? sigma : -sigma;
    float w = 1.0 / (s * v2.x - v1.x), w0 = (v1.y - s * v2.y) * w, w1 = (v1.z - s * v2.z) * w;
    float a = 1.0 / ((a13 - a12) * w1 * w1 - a12 * b13 * w1 - a12);
    float b = (a13 * b12 * w1 - a12 * b13 * w0 - 2.0 * w0 * w1 * (a12 - a13)) * a;
    float c = ((a13 - a12) * w0 * w0 + a13 * b12 * w0 + a13) * a;
    vec2 taus = square_roots(b, c);
    for (int root = 0; root < 2; ++root) {
      float tau = root == 0 ? taus.x : taus.y, d = a23 / (tau * (b23 + tau) + 1.0);
      float l2 = sqrt(max(d, 0.0)), l3 = tau * l2, l1 = w0 * l2 + w1 * l3;
      // Comparisons with NaN are false.
      if (b * b - 4.0 * c >= 0.0 && tau > 0.0 && d > 0.0 && l1 >= 0.0) solutions[count++] = vec3(l1, l2, l3);
    }
  }
  // Newton steps on the three distances, to recover the losses of single precision.
  for (int k = 0; k < count; ++k) {
    vec3 l = solutions[k];
    for (int i = 0; i < 3; ++i) {
      vec3 r = vec3(l.x * l.x + l.y * l.y + b12 * l.x * l.y - a12, l.x * l.x + l.z * l.z + b13 * l.x * l.z - a13,
                    l.y * l.y + l.z * l.z + b23 * l.y * l.z - a23);
      mat3 J = mat3(2.0 * l.x + b12 * l.y, 2.0 * l.x + b13 * l.z, 0.0,  // columns
                    2.0 * l.y + b12 * l.x, 0.0, 2.0 * l.y + b23 * l.z,
                    0.0, 2.0 * l.z + b13 * l.x, 2.0 * l.z + b23 * l.y);
      vec3 step = inverse(J) * r;
      l -= is_finite(dot(step, step)) ? step : vec3(0.0);
    }
    solutions[k] = l;
  }
  return count;
}

// Orthonormal frame of a triangle with sides a and b.
mat3 frame(vec3 a, vec3 b) {
  vec3 x = normalize(a), z = normalize(cross(a, b));
  return mat3(x, cross(z, x), z);
}

// X_1 = R X_0 + t from points x_i of camera 0 and the points l_i y_i of camera 1.
Pose pose_of_triangles(vec3 x1, vec3 x2, vec3 x3, vec3 z1, vec3 z2, vec3 z3) {
  mat3 R = frame(z1 - z2, z1 - z3) * transpose(frame(x1 - x2, x1 - x3));
  return Pose(R, z1 - R * x1);
}
