#include <iclk/align/solver/agreement.h>

#include <algorithm>

#include <iclk/align/solver/jacobian.h>
#include <iclk/shaders/shared.h>

namespace iclk::internal {
namespace {

// The gradient of the bilinear surface, which the residuals of the iterations follow.
Eigen::RowVector2d surface_gradient(const Map& f, double u, double v) {
  const int u0 = std::min(static_cast<int>(u), f.width - 2), v0 = std::min(static_cast<int>(v), f.height - 2);
  const double fu = u - u0, fv = v - v0;
  const double f00 = f.at(u0, v0), f10 = f.at(u0 + 1, v0), f01 = f.at(u0, v0 + 1), f11 = f.at(u0 + 1, v0 + 1);
  return {(1 - fv) * (f10 - f00) + fv * (f11 - f01), (1 - fu) * (f01 - f00) + fu * (f11 - f10)};
}

// d(warped pixel) / d(pixel) for a constant inverse depth.
Eigen::Matrix2d warp_jacobian(const Camera& c, const SE3& T_10, const TemplatePixel& p) {
  const Eigen::Vector3d ray((p.u - c.cx) / c.fx, (p.v - c.cy) / c.fy, 1.0);
  const Eigen::Vector3d X = T_10.R * ray + static_cast<double>(p.inverse_depth) * T_10.t;
  const Eigen::Vector2d x = X.head<2>() / X.z();
  Eigen::Matrix2d A = (T_10.R.topLeftCorner<2, 2>() - x * T_10.R.bottomLeftCorner<1, 2>()) / X.z();
  A.row(0) *= c.fx;
  A.row(1) *= c.fy;
  A.col(0) /= c.fx;
  A.col(1) /= c.fy;
  return A;
}

}  // namespace

Agreement& Agreement::operator+=(const Agreement& other) {
  cross += other.cross;
  target += other.target;
  patch_scores += other.patch_scores;
  pixel_scores += other.pixel_scores;
  patches += other.patches;
  return *this;
}

double Agreement::variance_ratio(double parameters) const {
  if (!(pixel_scores > 0)) return 1;
  // Each patch has two scores; the estimate has made `parameters` combinations of them zero.
  return std::max(1.0, patch_scores / pixel_scores * 2 * patches / std::max(2 * patches - parameters, 1.0));
}

Agreement agreement(const Template& pixels, const Map& f1, const Camera& level_camera, const Point& at,
                    std::span<const float> weights) {
  Agreement sums;
  Eigen::Vector2d score = Eigen::Vector2d::Zero();  // of the patch
  bool seen = false;
  for (size_t k = 0; k < pixels.size(); ++k) {
    if (k % ICLK_PATCH_AREA == 0) {
      sums.patch_scores += score.squaredNorm();
      score.setZero();
      seen = false;
    }
    const TemplatePixel& p = pixels[k];
    if (!(p.inverse_depth > 0)) continue;
    const Warped w = warp(level_camera, at.T_10, p, f1);
    if (!w.visible) continue;
    const double weight = weights.empty() ? 1.0 : weights[k];
    const double r = f1.bilinear(w.u, w.v) - (at.gain * p.f0 + at.bias);
    const Eigen::Vector2d pixel_score = weight * r * Eigen::Vector2d(p.gu, p.gv);
    score += pixel_score;
    sums.pixel_scores += pixel_score.squaredNorm();
    sums.patches += !seen;
    seen = true;
    const Eigen::RowVector2d g = surface_gradient(f1, w.u, w.v) * warp_jacobian(level_camera, at.T_10, p);
    TemplatePixel moved = p;
    moved.gu = static_cast<float>(g.x());
    moved.gv = static_cast<float>(g.y());
    const Eigen::Matrix<double, 1, 6> J0 = jacobian(p, level_camera), J1 = jacobian(moved, level_camera);
    const Matrix6d J0J1 = J0.transpose() * J1;
    sums.cross += 0.5 * weight * (J0J1 + J0J1.transpose());
    sums.target += weight * J1.transpose() * J1;
  }
  sums.patch_scores += score.squaredNorm();
  return sums;
}

}  // namespace iclk::internal
