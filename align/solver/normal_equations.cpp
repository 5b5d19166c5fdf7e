#include <iclk/align/solver/normal_equations.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include <iclk/align/solver/jacobian.h>
#include <iclk/shaders/shared.h>

namespace iclk::internal {

NormalSums::Moments NormalSums::moments(const Point& at) const {
  const double n = weight();
  // f1 = r + a f0 + b
  const double s0 = H(6, 7), s00 = H(6, 6), sr = g(7), s0r = g(6);
  const double s1 = sr + at.gain * s0 + at.bias * n;
  const double s01 = s0r + at.gain * s00 + at.bias * s0;
  const double s11 =
      cost + 2 * (at.gain * s0r + at.bias * sr) + at.gain * at.gain * s00 + 2 * at.gain * at.bias * s0 + at.bias * at.bias * n;
  const double m1 = cost + 2 * (std::abs(at.gain * s0r) + std::abs(at.bias * sr)) + at.gain * at.gain * s00 +
                    2 * std::abs(at.gain * at.bias * s0) + at.bias * at.bias * n;
  return {s00 - s0 * s0 / n, s11 - s1 * s1 / n, s01 - s0 * s1 / n, s00, m1};
}

bool NormalSums::textured(const Point& at) const {
  if (!(weight() > 0)) return false;
  const Moments m = moments(at);
  // A spread that may be rounding of a device's sums is not texture: below 1/1000 for grey values around 1/2.
  return m.v0 > ICLK_LEAST_SPREAD * m.m0 && m.v1 > ICLK_LEAST_SPREAD * m.m1;
}

double NormalSums::correlation(const Point& at) const {
  if (!textured(at)) return 0;
  const Moments m = moments(at);
  return std::clamp(m.v01 / std::sqrt(m.v0 * m.v1), -1.0, 1.0);
}

std::vector<float> residuals(const Template& pixels, const Map& f1, const Camera& level_camera, const Point& at) {
  std::vector<float> r(pixels.size(), std::numeric_limits<float>::quiet_NaN());
  for (size_t k = 0; k < pixels.size(); ++k) {
    const TemplatePixel& p = pixels[k];
    if (!(p.inverse_depth > 0)) continue;
    if (const Warped w = warp(level_camera, at.T_10, p, f1); w.visible)
      r[k] = static_cast<float>(f1.bilinear(w.u, w.v) - (at.gain * p.f0 + at.bias));
  }
  return r;
}

NormalSums normal_equations(const Template& pixels, const Map& f1, const Camera& level_camera, const Point& at,
                            std::span<const float> weights) {
  NormalSums sums;
  for (size_t k = 0; k < pixels.size(); ++k) {
    const TemplatePixel& p = pixels[k];
    if (!(p.inverse_depth > 0)) continue;
    sums.masked += 1;
    const Warped w = warp(level_camera, at.T_10, p, f1);
    if (!w.visible) continue;
    sums.visible += 1;
    const double weight = weights.empty() ? 1.0 : weights[k];
    const double r = f1.bilinear(w.u, w.v) - (at.gain * p.f0 + at.bias);
    Vector8d J;
    J << jacobian(p, level_camera).transpose(), p.f0, 1.0;
    const Vector8d wJ = weight * J;
    sums.H.selfadjointView<Eigen::Lower>().rankUpdate(J, weight);
    sums.g += r * wJ;
    sums.cost += weight * r * r;
  }
  sums.H.triangularView<Eigen::StrictlyUpper>() = sums.H.transpose();
  return sums;
}

}  // namespace iclk::internal
