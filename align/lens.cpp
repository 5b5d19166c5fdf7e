#include <iclk/align/lens.h>

#include <algorithm>
#include <cmath>
#include <string>

#include <Eigen/LU>

#include <iclk/engine/error.h>

namespace iclk {
namespace {

constexpr double kWidestRadius = 4;  // of radtan: 76 degrees
constexpr int kSteps = 4000;         // of the search for the edge of the domain
constexpr int kRadialIterations = 60, kIterations = 30;
constexpr double kExact = 1e-12;

}  // namespace

Lens::Lens(Distortion distortion) : distortion_(std::move(distortion)) {
  const std::vector<double>& k = distortion_.k;
  const auto fail = [](const std::string& why) { throw Error(ErrorCode::invalid_argument, "lens: " + why); };
  for (const double x : k)
    if (!std::isfinite(x)) fail("a coefficient is not finite");
  switch (distortion_.model) {
    case Distortion::Model::none: return;
    case Distortion::Model::radtan:
      if (k.size() != 4 && k.size() != 5 && k.size() != 8)
        fail("radtan takes 4, 5 or 8 coefficients, not " + std::to_string(k.size()));
      if (k.size() == 8) denominator_ << k[5], k[6], k[7];
      radial_ << k[0], k[1], k.size() > 4 ? k[4] : 0, 0;
      tangential_ << k[2], k[3];
      limit_ = kWidestRadius;
      break;
    case Distortion::Model::equidistant:
      if (k.size() != 4) fail("equidistant takes 4 coefficients, not " + std::to_string(k.size()));
      radial_ << k[0], k[1], k[2], k[3];
      limit_ = kWidestAngle;
      break;
  }
  const double widest = limit_;
  for (int i = 0; i <= kSteps; ++i)
    if (slope(widest * i / kSteps) <= 0) {
      limit_ = widest * std::max(i - 1, 0) / kSteps;  // the last radius at which it grows
      break;
    }
  radius_ = distortion_.model == Distortion::Model::equidistant ? std::tan(limit_) : limit_;
}

double Lens::f(double r) const {
  const double q = r * r;
  const double below = 1 + q * (denominator_[0] + q * (denominator_[1] + q * denominator_[2]));
  return r * (1 + q * (radial_[0] + q * (radial_[1] + q * (radial_[2] + q * radial_[3])))) / below;
}

double Lens::slope(double r) const {
  const double q = r * r;
  const double rise = 1 + q * (3 * radial_[0] + q * (5 * radial_[1] + q * (7 * radial_[2] + q * 9 * radial_[3])));
  const double below = 1 + q * (denominator_[0] + q * (denominator_[1] + q * denominator_[2]));
  if (below <= 0) return -1;  // a pole
  const double below_rise = q * (2 * denominator_[0] + q * (4 * denominator_[1] + q * 6 * denominator_[2]));
  return (rise - f(r) / std::max(r, 1e-300) * below_rise) / below;
}

/// The inverse of f in 0 .. limit(), or the nearer end, by Newton's method with bisection outside the bracket.
double Lens::inverse(double seen) const {
  double low = 0, high = limit_, r = std::min(seen, high);
  for (int i = 0; i < kRadialIterations; ++i) {
    const double error = f(r) - seen;
    (error > 0 ? high : low) = r;
    const double before = r, next = r - error / slope(r);
    r = next >= low && next <= high ? next : 0.5 * (low + high);
    if (r == before) break;
  }
  return r;
}

Eigen::Vector2d Lens::distort(const Eigen::Vector2d& xy) const {
  if (empty()) return xy;
  const double r = xy.norm();
  if (distortion_.model == Distortion::Model::equidistant) return r > 0 ? Eigen::Vector2d(xy * (f(std::atan(r)) / r)) : xy;
  const double x = xy.x(), y = xy.y(), p1 = tangential_.x(), p2 = tangential_.y();
  const Eigen::Vector2d tangential(2 * p1 * x * y + p2 * (r * r + 2 * x * x), p1 * (r * r + 2 * y * y) + 2 * p2 * x * y);
  return (r > 0 ? Eigen::Vector2d(xy * (f(r) / r)) : xy) + tangential;
}

Eigen::Matrix2d Lens::jacobian(const Eigen::Vector2d& xy) const {
  const double r = xy.norm(), x = xy.x(), y = xy.y(), p1 = tangential_.x(), p2 = tangential_.y();
  if (!(r > 0)) return Eigen::Matrix2d::Identity();
  const Eigen::Vector2d n = xy / r;
  const Eigen::Matrix2d along = n * n.transpose();
  Eigen::Matrix2d J = slope(r) * along + f(r) / r * (Eigen::Matrix2d::Identity() - along), T;
  T << 2 * p1 * y + 6 * p2 * x, 2 * p1 * x + 2 * p2 * y, 2 * p1 * x + 2 * p2 * y, 6 * p1 * y + 2 * p2 * x;
  return J + T;
}

std::optional<Eigen::Vector2d> Lens::undistort(const Eigen::Vector2d& distorted) const {
  if (empty()) return distorted;
  const double seen = distorted.norm();
  if (!std::isfinite(seen)) return {};
  const double r = inverse(seen);
  Eigen::Vector2d xy = seen > 0 ? Eigen::Vector2d(distorted * (r / seen)) : Eigen::Vector2d::Zero();
  if (distortion_.model == Distortion::Model::equidistant) {
    if (!(r < limit_ && std::abs(f(r) - seen) < kExact)) return {};
    return r > 0 ? Eigen::Vector2d(distorted * (std::tan(r) / seen)) : xy;
  }
  for (int i = 0; i < kIterations; ++i) {
    const Eigen::Vector2d error = distort(xy) - distorted;
    if (error.norm() < 0.1 * kExact) break;
    xy -= jacobian(xy).inverse() * error;
  }
  const bool found = (distort(xy) - distorted).norm() < kExact && xy.norm() < limit_ && jacobian(xy).determinant() > 0;
  return found ? std::optional(xy) : std::nullopt;
}

std::optional<Eigen::Vector2d> pinhole_pixel(const Camera& camera, const Lens& lens, const Eigen::Vector2d& uv) {
  const auto xy = lens.undistort(camera.ray(uv).head<2>());
  return xy ? std::optional(camera.project({xy->x(), xy->y(), 1})) : std::nullopt;
}

}  // namespace iclk
