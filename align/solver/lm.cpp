#include <iclk/align/solver/lm.h>

#include <algorithm>
#include <cmath>

#include <Eigen/Dense>

#include <iclk/shaders/shared.h>

namespace iclk::internal {

Matrix6d prior_information(const PosePrior& prior, const SE3& T_10) {
  const Matrix6d J = inverse_right_jacobian((prior.T_10.inverse() * T_10).log());
  return J.transpose() * prior.information * J;
}

Matrix6d pose_information(const NormalSums& sums, const Point& at, bool photometric) {
  Matrix6d H = at.gain * at.gain * sums.H.topLeftCorner<6, 6>();
  if (!photometric) return H;
  const Eigen::Matrix<double, 6, 2> B = at.gain * sums.H.topRightCorner<6, 2>();
  const Eigen::Matrix2d C = sums.H.bottomRightCorner<2, 2>();
  if (std::abs(C.determinant()) > 1e-12 * C(0, 0) * C(1, 1)) H -= B * C.ldlt().solve(B.transpose());
  return 0.5 * (H + H.transpose());
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

double LmIteration::residual_variance(const NormalSums& sums) const {
  const AlignerOptions& options = *problem_.options;
  if (options.carry == 0) return options.residual_sigma * options.residual_sigma;
  return std::max(sums.mean_cost(), ICLK_LEAST_SIGMA * ICLK_LEAST_SIGMA);
}

void LmIteration::believe() {
  const AlignerOptions& options = *problem_.options;
  Matrix6d information = options.carry / variance_ * pose_information(sums_, accepted_, options.photometric);
  if (!information.allFinite()) information.setZero();  // a level without a result must not spoil the next
  if (belief_) information += prior_information(*belief_, point_.T_10);
  belief_ = PosePrior{point_.T_10, information};
}

void LmIteration::begin_level(const Camera& level_camera) {
  if (has_accepted_ && problem_.options->carry > 0) believe();
  focal_ = std::max(std::abs(level_camera.fx), std::abs(level_camera.fy));
  lambda_ = problem_.options->lambda;
  nu_ = 2;
  has_accepted_ = done_ = singular_ = false;
  last_step_ = 0;
}

LmIteration::System LmIteration::system(const NormalSums& sums, const Point& at, double variance) const {
  System s{sums.H, sums.g, sums.cost};
  // The pose moves gain * f0, so its columns are multiplied by the gain.
  s.H.topRows<6>() *= at.gain;
  s.H.leftCols<6>() *= at.gain;
  s.g.head<6>() *= at.gain;
  if (!problem_.options->photometric) {
    s.H.bottomRows<2>().setZero();
    s.H.rightCols<2>().setZero();
    s.H(6, 6) = s.H(7, 7) = 1;
    s.g.tail<2>().setZero();
  }
  if (belief_) {
    // e(T Exp(xi)^-1) = e - J_r^-1(e) xi, weighted against residuals of that variance.
    const Vector6d e = (belief_->T_10.inverse() * at.T_10).log();
    const Matrix6d J = inverse_right_jacobian(e);
    const Matrix6d A = variance * J.transpose() * belief_->information;
    s.H.topLeftCorner<6, 6>() += A * J;
    s.g.head<6>() += A * e;
    s.objective += variance * e.dot(belief_->information * e);
  }
  return s;
}

bool LmIteration::judge(const NormalSums& sums) {
  if (problem_.options->damping == Damping::adaptive && has_accepted_) {
    // Costs are compared as means, times the weight of the accepted point, so that pixels leaving the image do not look like
    // progress.
    const System now = system(sums, point_, variance_);
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
  variance_ = residual_variance(sums);
  accepted_system_ = system(sums, point_, variance_);
  has_accepted_ = true;
  return true;
}

void LmIteration::propose() {
  // Scaled to a unit diagonal, so that the test of pivots does not depend on the units of scene and image.
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
