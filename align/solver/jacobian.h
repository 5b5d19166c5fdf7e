#pragma once
#include <span>

#include <iclk/align/features.h>
#include <iclk/align/pyramid.h>
#include <iclk/align/solver/level.h>

namespace iclk::internal {

/// The template of one level in sparse mode: position, inverse depth, f0 and gradient of each patch pixel of `mask`.
Template sparse_template(const Map& f0, const Features& features, std::span<const float> mask, int level);

/// The template in dense mode: one element per pixel.
Template dense_template(const Map& f0, const Map& inverse_depth);

/// A row of the template Jacobian, df0(u(Exp(xi))) / d[rho, phi] at xi = 0 (paper, eq. 3):
///   ju = fx [q, 0, -q x, -x y, 1 + x^2, -y],   jv = fy [0, q, -q y, -(1 + y^2), x y, x],   J = gu ju + gv jv.
inline Eigen::Matrix<double, 1, 6> jacobian(const TemplatePixel& p, const Camera& level_camera) {
  const double x = (p.u - level_camera.cx) / level_camera.fx, y = (p.v - level_camera.cy) / level_camera.fy;
  const double q = p.inverse_depth, a = p.gu * level_camera.fx, b = p.gv * level_camera.fy;
  Eigen::Matrix<double, 1, 6> J;
  J << a * q, b * q, -q * (a * x + b * y), -(a * x * y + b * (1 + y * y)), a * (1 + x * x) + b * x * y, b * x - a * y;
  return J;
}

}  // namespace iclk::internal
