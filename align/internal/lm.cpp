#include <iclk/align/internal/lm.h>

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

#include <iclk/shaders/shared.h>

namespace iclk::internal {

Matrix6d prior_information(const PosePrior& prior, const SE3& T_10) {
  const Matrix6d J = inverse_right_jacobian((prior.T_10.inverse() * T_10).log());
  return J.transpose() * prior.information * J;
}

void LmIteration::start_photometric(const NormalSums& sums) {
  const double n = sums.weight();
  if (!(n > 0)) return;
  const double s0 = sums.H(6, 7), s00 = sums.H(6, 6);
  const double s1 = sums.g(7) + s0, s11 = sums.cost + 2 * sums.g(6) + s00;
  const double v0 = s00 - s0 * s0 / n, v1 = s11 - s1 * s1 / n;
  if (!(v0 > 1e-9 * n) || !(v1 > 0)) return;
  point_.gain = std::clamp(std::sqrt(v1 / v0), ICLK_GAIN_MIN, ICLK_GAIN_MAX);
  point_.bias = (s1 - point_.gain * s0) / n;
}

void LmIteration::begin_level(const Camera& level_camera) {
  focal_ = std::max(std::abs(level_camera.fx), std::abs(level_camera.fy));
  lambda_ = problem_.options->lambda;
  nu_ = 2;
  has_accepted_ = done_ = singular_ = false;
  last_step_ = 0;
}

LmIteration::System LmIteration::system(const NormalSums& sums, const Point& at) const {
  System s{sums.H, sums.g, sums.cost};
  // The pose moves gain * f0, so its columns count `gain` times.
  s.H.topRows<6>() *= at.gain;
  s.H.leftCols<6>() *= at.gain;
  s.g.head<6>() *= at.gain;
  if (!problem_.options->photometric) {
    s.H.bottomRows<2>().setZero();
    s.H.rightCols<2>().setZero();
    s.H(6, 6) = s.H(7, 7) = 1;
    s.g.tail<2>().setZero();
  }
  if (problem_.prior) {
    // e(T Exp(xi)^-1) = e - J_r^-1(e) xi, weighted against residuals of variance residual_sigma^2.
    const double variance = problem_.options->residual_sigma * problem_.options->residual_sigma;
    const Vector6d e = (problem_.prior->T_10.inverse() * at.T_10).log();
    const Matrix6d J = inverse_right_jacobian(e);
    const Matrix6d A = variance * J.transpose() * problem_.prior->information;
    s.H.topLeftCorner<6, 6>() += A * J;
    s.g.head<6>() += A * e;
    s.objective += variance * e.dot(problem_.prior->information * e);
  }
  return s;
}

bool LmIteration::judge(const NormalSums& sums) {
  System now = system(sums, point_);
  if (problem_.options->damping == Damping::adaptive && has_accepted_) {
    // Pixels that left the image must not count as progress: costs are compared as means, on the accepted point's weight.
    const double share = sums.weight() > 0 ? sums_.weight() / sums.weight() : 1e30;
    const double objective = now.objective + sums.cost * (share - 1);
    const double ratio = predicted_ > 0 ? (accepted_system_.objective - objective) / predicted_ : 0;
    if (!(ratio > ICLK_LM_ACCEPT)) {
      lambda_ = std::max(lambda_ * nu_, ICLK_LM_REJECTED);
      nu_ *= 2;
      point_ = accepted_;
      return false;
    }
    const double x = 2 * ratio - 1;
    lambda_ = std::max(lambda_ * std::max(1.0 / 3.0, 1 - x * x * x), ICLK_LM_LEAST);
    nu_ = 2;
  }
  accepted_ = point_;
  sums_ = sums;
  accepted_system_ = now;
  has_accepted_ = true;
  return true;
}

void LmIteration::propose() {
  // Scaled to a unit diagonal, so that pivots can be compared with rounding whatever the units of scene and image.
  const Vector8d diagonal = accepted_system_.H.diagonal();
  const Vector8d d = diagonal.cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  Matrix8d A = d.asDiagonal() * accepted_system_.H * d.asDiagonal();
  A.diagonal().setConstant(1 + lambda_);
  const Eigen::LDLT<Matrix8d> ldlt(A);
  const Vector8d xi = d.asDiagonal() * ldlt.solve(d.asDiagonal() * accepted_system_.g);
  const bool solved = ldlt.info() == Eigen::Success && ldlt.vectorD().minCoeff() > ICLK_LEAST_PIVOT;
  if (!(diagonal.minCoeff() > 0) || !solved || !xi.allFinite()) {
    singular_ = done_ = true;
    last_step_ = 0;
    return;
  }
  predicted_ = xi.dot(accepted_system_.g + lambda_ * accepted_system_.H.diagonal().cwiseProduct(xi));
  point_.T_10 = accepted_.T_10 * SE3::exp(-xi.head<6>());  // T_10 <- T_10 Exp(xi)^-1
  if (problem_.options->photometric) {
    point_.gain = std::clamp(accepted_.gain + xi(6), ICLK_GAIN_MIN, ICLK_GAIN_MAX);
    point_.bias = accepted_.bias + xi(7);
  }
  last_step_ = focal_ * (xi.segment<3>(3).norm() + xi.head<3>().norm() * problem_.mean_inverse_depth);
  done_ = last_step_ < problem_.options->step_tolerance;
}

IterationTrace LmIteration::step(const NormalSums& sums) {
  IterationTrace trace;
  trace.cost = sums.mean_cost();
  trace.visible = sums.visible_fraction();
  trace.accepted = judge(sums);
  trace.lambda = lambda_;
  propose();
  trace.step = last_step_;
  trace.T_10 = point_.T_10;
  return trace;
}

void LmIteration::end_level(const NormalSums& sums) {
  judge(sums);
  point_ = accepted_;
}

}  // namespace iclk::internal
