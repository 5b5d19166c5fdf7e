// The covariance parts of refine/internal/uncertainty.cpp in single precision.

shared float shared_part[36];  // a covariance; written by lane 0
shared float by[24];           // the effect of the pose on each of four columns

// The columns of a feature for errors of calibration (px of focal length and principal point) and depth (sigmas), whitened and
// weighted like its Jacobian.
struct SharedColumns {
  vec2 cx, cy, focal, depth;
};

SharedColumns shared_columns(Projection x, FeatureInfo f, Pose T, float relative_depth) {
  vec2 focal = vec2(reference.fx, reference.fy);
  mat3 R = T.R;
  vec2 d0 = vec2(dot(x.du, R[0]), dot(x.dv, R[0])), d1 = vec2(dot(x.du, R[1]), dot(x.dv, R[1]));  // du1 / dray
  SharedColumns c;
  c.cx = vec2(1.0, 0.0) - d0 / focal.x;
  c.cy = vec2(0.0, 1.0) - d1 / focal.y;
  c.focal = (x.uv1 - vec2(reference.cx, reference.cy) - d0 * x.ray.x - d1 * x.ray.y) / (0.5 * (abs(focal.x) + abs(focal.y)));
  c.depth = (f.relative_sigma > 0.0 ? f.relative_sigma : relative_depth) * along_epipolar(x, f.inverse_depth, T);
  return c;
}

struct WeightedFeature {
  Rows J;
  vec2 r, columns[4];  // cx, cy, focal, depth
};

WeightedFeature weighted_feature(uint i, Pose T, float scale, float relative_depth) {
  FeatureInfo f = feature_at(i);
  Projection x = project(f, T);
  vec2 r;
  float w = 1.0 / (1.0 + square_of(i, x, r) / (scale * scale));
  vec3 W = sqrt(w) * W_of(i);
  SharedColumns c = shared_columns(x, f, T, relative_depth);
  WeightedFeature out_;
  out_.J = whitened(W, jacobian(x, f.inverse_depth, T));
  out_.r = whitened(W, r);
  out_.columns = vec2[4](whitened(W, c.cx), whitened(W, c.cy), whitened(W, c.focal), whitened(W, c.depth));
  return out_;
}

#define TAKES_PART(i) (observations[i].used != 0u && project(feature_at(i), T).in_front)

// Computes the eigenvalues `s` of the symmetric matrix M, and V^T b, by Jacobi rotations.
void diagonalise(mat3 M, inout vec3 b, out vec3 s) {
  [[dont_unroll]] for (int sweep = 0; sweep < 8; ++sweep)
    [[dont_unroll]] for (int k = 0; k < 3; ++k) {
      int p = k == 2 ? 1 : 0, q = k == 0 ? 1 : 2;
      if (abs(M[p][q]) < 1e-30) continue;
      float theta = 0.5 * (M[q][q] - M[p][p]) / M[p][q];
      float t = (theta < 0.0 ? -1.0 : 1.0) / (abs(theta) + sqrt(theta * theta + 1.0));
      float c = inversesqrt(t * t + 1.0);
      mat3 G = mat3(1.0);
      G[p][p] = G[q][q] = c;
      G[q][p] = t * c;
      G[p][q] = -t * c;
      M = transpose(G) * M * G;
      b = transpose(G) * b;
    }
  s = vec3(M[0][0], M[1][1], M[2][2]);
}

// The log-likelihood of the calibration's variance tau, along an eigenvector with eigenvalue s.
float log_likelihood(float s, float b, float variance, float tau) {
  if (4.0 * s < 1e-4 * variance) return 0.0;  // even 2 px have no effect
  float v = variance + tau * s;
  return -0.5 * (log(v) + b * b / (s * v));
}

// shared_errors(): covariance into shared_part. `columns` is the inverse of J^T J over the weighted features, `psi2` and
// `weights` its sums of w^2 r^2 and w, `used` their number.
void shared_errors(Pose T, float scale, float relative_depth, float psi2, float weights, float used) {
  float s[SUMS];
  clear(s);
  EACH_FEATURE(i) {
    if (!TAKES_PART(i)) continue;
    WeightedFeature x = weighted_feature(i, T, scale, relative_depth);
    [[unroll]] for (int c = 0; c < 4; ++c)
      [[unroll]] for (int k = 0; k < 6; ++k) s[6 * c + k] += x.J.u[k] * x.columns[c].x + x.J.v[k] * x.columns[c].y;
  }
  sum(s);
  if (lane < 24u) {
    float t = 0.0;
    [[dont_unroll]] for (uint l = 0u; l < 6u; ++l) t += columns[6u * l + lane % 6u] * totals[6u * (lane / 6u) + l];
    by[lane] = t;
  }
  barrier();
  // The part of the calibration's columns that the pose cannot absorb.
  clear(s);
  EACH_FEATURE(i) {
    if (!TAKES_PART(i)) continue;
    WeightedFeature x = weighted_feature(i, T, scale, relative_depth);
    vec2 seen[3];
    [[unroll]] for (int c = 0; c < 3; ++c) {
      seen[c] = x.columns[c];
      [[unroll]] for (int k = 0; k < 6; ++k) seen[c] -= by[6 * c + k] * vec2(x.J.u[k], x.J.v[k]);
      s[6 + c] += dot(seen[c], x.r);
      s[c] += dot(seen[c], seen[c]);
    }
    s[3] += dot(seen[0], seen[1]);
    s[4] += dot(seen[0], seen[2]);
    s[5] += dot(seen[1], seen[2]);
  }
  sum(s);
  if (lane != 0u) return;
  [[dont_unroll]] for (int k = 0; k < 36; ++k) shared_part[k] = 0.0;
  float variance = psi2 / max(2.0 * used - 6.0, 1.0) / (weights / used);
  if (!(variance > 0.0)) return;
  vec3 b = vec3(s[6], s[7], s[8]), eigen;
  diagonalise(mat3(s[0], s[3], s[4], s[3], s[1], s[5], s[4], s[5], s[2]), b, eigen);
  // The weight of each sigma; zero has the weight of all others together. There are two passes, the largest sigma first.
  float most = -INFINITE, all = 0.0, mean = 0.0;
  [[dont_unroll]] for (int k = 0; k < 22; ++k) {
    float sigma = k % 11 == 0 ? 0.0 : 0.02 * pow(100.0, float(k % 11 - 1) / 9.0), tau = sigma * sigma;
    float log_weight = (sigma == 0.0 ? log(10.0) : 0.0) + log_likelihood(eigen.x, b.x, variance, tau) +
                       log_likelihood(eigen.y, b.y, variance, tau) + log_likelihood(eigen.z, b.z, variance, tau);
    if (k < 11) most = max(most, log_weight);
    if (k < 11) continue;
    float weight = exp(log_weight - most);
    all += weight;
    mean += weight * tau;
  }
  mean = push.camera_sigma < 0.0 ? mean / all : push.camera_sigma * push.camera_sigma;
  [[dont_unroll]] for (int k = 0; k < 36; ++k) {
    int i = k / 6, j = k % 6;
    float t = by[i] * by[j] + by[6 + i] * by[6 + j] + by[12 + i] * by[12 + j];
    shared_part[k] = mean * t + ICLK_COMMON_DEPTH * ICLK_COMMON_DEPTH * by[18 + i] * by[18 + j];
  }
}

// depth_covariance() at ICLK's own pose, into shared_part; zero if the features do not determine it.
void depth_covariance(Pose T, float relative_depth) {
  float H[SUMS], s[SUMS];
  clear(H);
  clear(s);
  EACH_FEATURE(i) {
    FeatureInfo f = feature_at(i);
    Projection x = project(f, T);
    bool inside = x.p.z > 0.0 && x.uv1.x >= 0.0 && x.uv1.y >= 0.0 && x.uv1.x <= float(push.width) - 1.0 &&
                  x.uv1.y <= float(push.height) - 1.0;
    if (!(f.inverse_depth > 0.0) || !x.in_front || !inside) continue;
    Rows J = jacobian(x, f.inverse_depth, T);
    vec2 a = (f.relative_sigma > 0.0 ? f.relative_sigma : relative_depth) * along_epipolar(x, f.inverse_depth, T);
    float moved[6];
    [[unroll]] for (int k = 0; k < 6; ++k) {
      moved[k] = J.u[k] * a.x + J.v[k] * a.y;
      H[21 + k] += ICLK_COMMON_DEPTH * moved[k];
    }
    add_products(H, 1.0, J.u, J.u);
    add_products(H, 1.0, J.v, J.v);
    add_products(s, 1.0, moved, moved);
    s[21] += 1.0;
  }
  sum(H);
  keep_totals();
  sum(s);
  factorise(0.0, ICLK_LEAST_EIGENVALUE);
  invert();
  if (lane >= 36u) return;
  // inverse (singles + common common^T) inverse + the common error of the maps
  uint i = lane / 6u, j = lane % 6u;
  float t = totals[21] * ICLK_MAP_SIGMA * ICLK_MAP_SIGMA * columns[lane];
  [[dont_unroll]] for (uint k = 0u; k < 6u; ++k)
    [[dont_unroll]] for (uint l = 0u; l < 6u; ++l) {
      uint lo = min(k, l), hi = max(k, l);
      t += columns[6u * i + k] * (totals[TRIANGLE(lo, hi)] + matrix[21u + k] * matrix[21u + l]) * columns[6u * l + j];
    }
  shared_part[lane] = positive ? t : 0.0;
}
