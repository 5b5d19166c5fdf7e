#include <iclk/track/internal/depth_filter.h>

#include <cmath>

#include <Eigen/LU>

#include <iclk/refine/pose.h>

namespace iclk::internal {
namespace {

constexpr double kLeastDepth = 1e-3;  // of the point in camera 1, times its inverse depth
constexpr int kSteps = 3;             // the weights of the linear solution are nearly right

}  // namespace

double inverse_depth_at(const Eigen::Vector3d& r, const Eigen::Vector3d& t, const Eigen::Vector3d& ray1) {
  // (r + q t) x ray1 = 0 is linear in q.
  const Eigen::Vector2d rest(r.x() - ray1.x() * r.z(), r.y() - ray1.y() * r.z());
  const Eigen::Vector2d slope(t.x() - ray1.x() * t.z(), t.y() - ray1.y() * t.z());
  return -rest.dot(slope) / slope.squaredNorm();
}

std::optional<DepthSighting> triangulate(const Camera& camera, const Eigen::Vector2d& uv0, const SE3& T_10,
                                         const Eigen::Vector2d& uv1, const Eigen::Matrix2d& covariance,
                                         const Matrix6d& pose_covariance) {
  const Eigen::Vector3d r = T_10.R * camera.ray(uv0), ray1 = camera.ray(uv1), &t = T_10.t;
  double q = inverse_depth_at(r, t, ray1);
  DepthSighting out;
  for (int step = 0; step < kSteps; ++step) {
    const Eigen::Vector3d p = r + q * t;
    if (!(p.z() > kLeastDepth)) return {};
    const Eigen::Vector2d J = camera.project_jacobian(p) * t, residual = uv1 - camera.project(p);
    Eigen::Matrix2d S = covariance;
    if (q > 0 && !pose_covariance.isZero(0)) {
      const auto J_xi = reprojection_jacobian(camera, T_10, camera.ray(uv0) / q);
      S += J_xi * pose_covariance * J_xi.transpose();
    }
    const Eigen::Matrix2d weight = S.inverse();
    const double information = J.dot(weight * J), correction = J.dot(weight * residual) / information;
    q += correction;
    out.sigma = 1 / std::sqrt(information);
    // The residual after the correction.
    const double chi2 = residual.dot(weight * residual) - correction * correction * information;
    out.off_line = std::sqrt(std::max(0.0, chi2));
  }
  out.inverse_depth = q;
  if (!std::isfinite(q) || !(out.sigma > 0) || !std::isfinite(out.sigma) || !((r + q * t).z() > kLeastDepth)) return {};
  return out;
}

double parallax(const Camera& camera, const Eigen::Vector2d& uv0, double q, const SE3& T_10) {
  const Eigen::Vector3d p = T_10.R * camera.ray(uv0) + q * T_10.t;
  return p.z() > kLeastDepth ? (camera.project_jacobian(p) * T_10.t).norm() : 0;
}

DepthFilter DepthFilter::between(double low, double high) {
  // Two standard deviations to either side.
  return {.mean = (low + high) / 2, .sigma = (high - low) / 4, .range = high - low};
}

void DepthFilter::add(double x, double sigma_x) {
  const double variance = sigma * sigma, variance_x = sigma_x * sigma_x, total = variance + variance_x;
  const double fused = variance * variance_x / total, m = (mean * variance_x + x * variance) / total;
  const double off = x - mean;
  double right = a / (a + b) * std::exp(-0.5 * off * off / total) / std::sqrt(2 * M_PI * total);
  double wrong = b / (a + b) / range;
  right /= right + wrong;  // wrong > 0
  wrong = 1 - right;
  const double new_mean = right * m + wrong * mean;
  const double new_variance = right * (fused + m * m) + wrong * (variance + mean * mean) - new_mean * new_mean;
  // First and second moment of pi.
  const double n = a + b;
  const double f = right * (a + 1) / (n + 1) + wrong * a / (n + 1);
  const double e = right * (a + 1) * (a + 2) / ((n + 1) * (n + 2)) + wrong * a * (a + 1) / ((n + 1) * (n + 2));
  mean = new_mean;
  sigma = std::sqrt(std::max(new_variance, 0.0));
  a = (e - f) / (f - e / f);
  b = a * (1 - f) / f;
}

}  // namespace iclk::internal
