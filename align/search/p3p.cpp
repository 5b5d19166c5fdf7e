#include <iclk/align/search/p3p.h>

#include <cmath>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace iclk::internal {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Roots of x^2 + b x + c, the larger magnitude first.
std::array<double, 2> square_roots(double b, double c) {
  const double root = std::sqrt(std::max(0.25 * b * b - c, 0.0));
  const double larger = b < 0 ? root - 0.5 * b : -root - 0.5 * b;
  return {larger, larger != 0 ? c / larger : 0};
}

// The real root of x^3 + b x^2 + c x + d where the slope is steepest.
double cube_root(double b, double c, double d) {
  const double q = (b * b - 3 * c) / 9, r = (2 * b * b * b - 9 * b * c + 27 * d) / 54, q3 = q * q * q;
  const auto slope = [&](double x) { return (3 * x + 2 * b) * x + c; };
  double x;
  if (r * r < q3) {
    const double size = -2 * std::sqrt(q), angle = std::acos(std::clamp(r / std::sqrt(q3), -1.0, 1.0)) / 3;
    const double least = size * std::cos(angle) - b / 3, most = size * std::cos(angle + 2 * M_PI / 3) - b / 3;
    x = std::abs(slope(least)) > std::abs(slope(most)) ? least : most;
  } else {
    const double a = -std::copysign(std::cbrt(std::abs(r) + std::sqrt(std::max(r * r - q3, 0.0))), r);
    x = a + (a != 0 ? q / a : 0) - b / 3;
  }
  for (int i = 0; i < 3; ++i)
    if (slope(x) != 0) x -= (((x + b) * x + c) * x + d) / slope(x);
  return x;
}

// The eigenvector of eigenvalue e of a symmetric matrix with a zero eigenvalue.
Vector3d eigenvector(double e, const Matrix3d& M) {
  const double scale = 1 / (e * (M(0, 0) + M(1, 1)) - M(0, 0) * M(1, 1) - e * e + M(0, 1) * M(0, 1));
  const double a = -scale * (e * M(0, 2) + M(0, 1) * M(1, 2) - M(0, 2) * M(1, 1));
  const double b = -scale * (e * M(1, 2) + M(0, 1) * M(0, 2) - M(0, 0) * M(1, 2));
  return Vector3d(a, b, 1).normalized();
}

// Orthonormal frame of a triangle with sides a and b.
Matrix3d frame(const Vector3d& a, const Vector3d& b) {
  Matrix3d F;
  F.col(0) = a.normalized();
  F.col(2) = a.cross(b).normalized();
  F.col(1) = F.col(2).cross(F.col(0));
  return F;
}

}  // namespace

std::vector<SE3> p3p(const std::array<Vector3d, 3>& x, const std::array<Vector3d, 3>& rays) {
  const std::array<Vector3d, 3> y = {rays[0].normalized(), rays[1].normalized(), rays[2].normalized()};
  const double a12 = (x[0] - x[1]).squaredNorm(), a13 = (x[0] - x[2]).squaredNorm(), a23 = (x[1] - x[2]).squaredNorm();
  const double c12 = y[0].dot(y[1]), c13 = y[0].dot(y[2]), c23 = y[1].dot(y[2]);
  const double s12 = 1 - c12 * c12, s13 = 1 - c13 * c13, s23 = 1 - c23 * c23, blob = c12 * c23 * c13 - 1;
  const double b12 = -2 * c12, b13 = -2 * c13, b23 = -2 * c23;
  const double p3 = a13 * (a23 * s13 - a13 * s23);
  const double p2 = 2 * blob * a23 * a13 + a13 * (2 * a12 + a13) * s23 + a23 * (a23 - a12) * s13;
  const double p1 = a23 * (a13 - a23) * s12 - a12 * a12 * s23 - 2 * a12 * (blob * a23 + a13 * s23);
  const double p0 = a12 * (a12 * s23 - a23 * s12);
  const double g = cube_root(p2 / p3, p1 / p3, p0 / p3);

  Matrix3d M;  // of the pencil of both quadrics, singular at g
  M << a23 * (1 - g), 0.5 * a23 * b12, -0.5 * a23 * b13 * g, 0.5 * a23 * b12, a23 - a12 + a13 * g, 0.5 * b23 * (a13 * g - a12),
      -0.5 * a23 * b13 * g, 0.5 * b23 * (a13 * g - a12), g * (a13 - a23) - a12;
  auto e = square_roots(-M.trace(), M(0, 0) * (M(1, 1) + M(2, 2)) + M(1, 1) * M(2, 2) - M(0, 1) * M(0, 1) - M(0, 2) * M(0, 2) -
                                        M(1, 2) * M(1, 2));
  const Vector3d v1 = eigenvector(e[0], M), v2 = eigenvector(e[1], M);
  const double sigma = std::sqrt(std::max(-e[1] / e[0], 0.0));

  std::vector<SE3> poses;
  for (const double s : {sigma, -sigma}) {
    const double w = 1 / (s * v2.x() - v1.x()), w0 = (v1.y() - s * v2.y()) * w, w1 = (v1.z() - s * v2.z()) * w;
    const double a = 1 / ((a13 - a12) * w1 * w1 - a12 * b13 * w1 - a12);
    const double b = (a13 * b12 * w1 - a12 * b13 * w0 - 2 * w0 * w1 * (a12 - a13)) * a;
    const double c = ((a13 - a12) * w0 * w0 + a13 * b12 * w0 + a13) * a;
    if (!(b * b - 4 * c >= 0)) continue;
    for (const double tau : square_roots(b, c)) {
      const double d = a23 / (tau * (b23 + tau) + 1);
      if (!(tau > 0 && d > 0)) continue;
      Vector3d l;
      l.y() = std::sqrt(d);
      l.z() = tau * l.y();
      l.x() = w0 * l.y() + w1 * l.z();
      if (!(l.x() >= 0)) continue;
      for (int i = 0; i < 3; ++i) {  // Newton's steps on the three distances
        const Vector3d r(l.x() * l.x() + l.y() * l.y() + b12 * l.x() * l.y() - a12,
                         l.x() * l.x() + l.z() * l.z() + b13 * l.x() * l.z() - a13,
                         l.y() * l.y() + l.z() * l.z() + b23 * l.y() * l.z() - a23);
        Matrix3d J;
        J << 2 * l.x() + b12 * l.y(), 2 * l.y() + b12 * l.x(), 0, 2 * l.x() + b13 * l.z(), 0, 2 * l.z() + b13 * l.x(), 0,
            2 * l.y() + b23 * l.z(), 2 * l.z() + b23 * l.y();
        const Vector3d step = J.inverse() * r;
        if (step.allFinite()) l -= step;
      }
      SE3 T;
      const Vector3d z1 = l.x() * y[0], z2 = l.y() * y[1], z3 = l.z() * y[2];
      T.R = frame(z1 - z2, z1 - z3) * frame(x[0] - x[1], x[0] - x[2]).transpose();
      T.t = z1 - T.R * x[0];
      if (T.R.allFinite() && T.t.allFinite()) poses.push_back(T);
    }
  }
  return poses;
}

}  // namespace iclk::internal
