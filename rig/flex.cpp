#include <iclk/rig/flex.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include <ceres/ceres.h>
#include <Eigen/Cholesky>
#include <Eigen/LU>

#include <iclk/engine/error.h>
#include <iclk/refine/internal/options_check.h>
#include <iclk/refine/internal/reprojection.h>
#include <iclk/rig/common_pose.h>

namespace iclk {
namespace {

using State = Eigen::Matrix<double, 12, 1>;  // xi, velocity
using Matrix12d = Eigen::Matrix<double, 12, 12>;

/// W Log(T_measured^-1 mean Exp(xi)).
class MeasurementCost final : public ceres::SizedCostFunction<6, 12> {
 public:
  MeasurementCost(const FlexMeasurement& m, const SE3& mean) : T_(m.T_rl.inverse() * mean) {
    const Matrix6d information = m.covariance.inverse();
    W_ = information.llt().matrixU();
  }
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const Vector6d xi = Eigen::Map<const Vector6d>(parameters[0]);
    const Vector6d e = (T_ * SE3::exp(xi)).log();
    Eigen::Map<Vector6d>{residuals} = W_ * e;
    if (!jacobians || !jacobians[0]) return true;
    Eigen::Map<Eigen::Matrix<double, 6, 12, Eigen::RowMajor>> to(jacobians[0]);
    to.setZero();
    to.leftCols<6>() = W_ * inverse_right_jacobian(e) * inverse_right_jacobian(xi).inverse();
    return true;
  }

 private:
  SE3 T_;
  Matrix6d W_;
};

/// W [xi_1 - xi_0 - dt v_0; v_1 - v_0], the covariance of white acceleration over dt.
class MotionCost final : public ceres::SizedCostFunction<12, 12, 12> {
 public:
  MotionCost(double dt, const Vector6d& density) {
    F_.setIdentity();
    F_.topRightCorner<6, 6>().diagonal().setConstant(dt);
    for (int k = 0; k < 6; ++k) {
      Eigen::Matrix2d Q;
      Q << dt * dt * dt / 3, dt * dt / 2, dt * dt / 2, dt;
      const Eigen::Matrix2d information = (Q * density[k]).inverse(), U = information.llt().matrixU();
      W_(k, k) = U(0, 0), W_(k, k + 6) = U(0, 1), W_(k + 6, k + 6) = U(1, 1);
    }
  }
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    Eigen::Map<State>{residuals} = W_ * (Eigen::Map<const State>(parameters[1]) - F_ * Eigen::Map<const State>(parameters[0]));
    using Block = Eigen::Matrix<double, 12, 12, Eigen::RowMajor>;
    if (jacobians && jacobians[0]) Eigen::Map<Block>{jacobians[0]} = -W_ * F_;
    if (jacobians && jacobians[1]) Eigen::Map<Block>{jacobians[1]} = W_;
    return true;
  }

 private:
  Matrix12d F_, W_ = Matrix12d::Zero();
};

/// The stated deviations, of position and speed.
class BoundCost final : public ceres::SizedCostFunction<12, 12> {
 public:
  explicit BoundCost(const State& sigma) : weight_(sigma.cwiseInverse()) {}
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    Eigen::Map<State>{residuals} = weight_.cwiseProduct(Eigen::Map<const State>(parameters[0]));
    if (jacobians && jacobians[0])
      Eigen::Map<Eigen::Matrix<double, 12, 12, Eigen::RowMajor>>{jacobians[0]} = weight_.asDiagonal().toDenseMatrix();
    return true;
  }

 private:
  State weight_;
};

void check(std::span<const FlexMeasurement> measurements) {
  const auto fail = [](size_t i, const char* what) {
    throw Error(ErrorCode::invalid_argument, "flex: measurement " + std::to_string(i) + " has " + what);
  };
  for (size_t i = 0; i < measurements.size(); ++i) {
    const FlexMeasurement& m = measurements[i];
    if (!std::isfinite(m.time) || (i > 0 && !(m.time > measurements[i - 1].time))) fail(i, "a time that is not later");
    if (!m.valid) continue;
    if (!m.T_rl.R.allFinite() || !m.T_rl.t.allFinite()) fail(i, "a pose that is not finite");
    if (!m.covariance.allFinite() || m.covariance.llt().info() != Eigen::Success)
      fail(i, "a covariance that is not positive definite");
  }
}

}  // namespace

void FlexOptions::check() const {
  check_range("flex rotation", rotation, 1e-9, 3);
  check_range("flex translation", translation, 1e-12, 1e9);
  check_range("flex frequency", frequency, 1e-6, 1e6);
  check_range("flex cauchy_scale", cauchy_scale, 1e-3, 1e6);
  check_range("flex iterations", iterations, 1, 10000);
}

FlexResult smooth_flex(std::span<const FlexMeasurement> measurements, const FlexOptions& options) {
  options.check();
  check(measurements);
  FlexResult result;
  State sigma;
  sigma.head<3>().setConstant(options.translation);
  sigma.segment<3>(3).setConstant(options.rotation);
  const double omega = 2 * std::numbers::pi * options.frequency;
  sigma.tail<6>() = omega * sigma.head<6>();
  // The mean counts every moment alike: what a pair knows of its moment says nothing of the others.
  std::vector<PoseVote> votes;
  for (const FlexMeasurement& m : measurements)
    if (m.valid) votes.push_back({m.T_rl, Matrix6d(sigma.head<6>().cwiseAbs2().asDiagonal()) + m.covariance, 0, 0});
  if (votes.empty()) return result;
  result.mean = common_pose(votes);

  // An oscillation of deviation s has accelerations of deviation s omega^2, alike for about a quarter of its period.
  const Vector6d density = (omega * omega * sigma.head<6>()).cwiseAbs2() / (4 * options.frequency);
  std::vector<State> states(measurements.size(), State::Zero());
  ceres::Problem problem;
  Vector6d last = Vector6d::Zero();
  for (size_t i = 0; i < states.size(); ++i) {
    const FlexMeasurement& m = measurements[i];
    if (m.valid) last = (result.mean.inverse() * m.T_rl).log();
    states[i].head<6>() = last;
    problem.AddParameterBlock(states[i].data(), 12);
    problem.AddResidualBlock(new BoundCost(3 * sigma), nullptr, states[i].data());
    if (m.valid)
      problem.AddResidualBlock(new MeasurementCost(m, result.mean),
                               new ceres::CauchyLoss(std::sqrt(6.0) * options.cauchy_scale), states[i].data());
    if (i > 0)
      problem.AddResidualBlock(new MotionCost(m.time - measurements[i - 1].time, density), nullptr, states[i - 1].data(),
                               states[i].data());
  }
  ceres::Solver::Options solver = internal::solver_options(options.iterations);
  solver.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);
  if (!summary.IsSolutionUsable()) return result;
  ceres::Covariance::Options covariance_options;
  covariance_options.algorithm_type = ceres::SPARSE_QR;
  ceres::Covariance covariance(covariance_options);
  std::vector<std::pair<const double*, const double*>> blocks;
  for (const State& s : states) blocks.emplace_back(s.data(), s.data());
  if (!covariance.Compute(blocks, &problem)) return result;
  for (size_t i = 0; i < states.size(); ++i) {
    Eigen::Matrix<double, 12, 12, Eigen::RowMajor> C;
    covariance.GetCovarianceBlock(states[i].data(), states[i].data(), C.data());
    // Of mean Exp(xi + d) = mean Exp(xi) Exp(J_r d).
    const Vector6d xi = states[i].head<6>();
    const Matrix6d J = inverse_right_jacobian(xi).inverse();
    result.states.push_back(
        {measurements[i].time, result.mean * SE3::exp(xi), J * C.topLeftCorner<6, 6>() * J.transpose(), states[i].tail<6>()});
  }
  result.usable = true;
  return result;
}

}  // namespace iclk
