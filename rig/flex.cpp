#include <iclk/rig/flex.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include <ceres/ceres.h>
#include <Eigen/Cholesky>
#include <Eigen/LU>

#include <iclk/align/common/options_check.h>
#include <iclk/engine/error.h>
#include <iclk/refine/internal/reprojection.h>
#include <iclk/rig/internal/common_pose.h>
#include <iclk/rig/internal/costs.h>

namespace iclk {
namespace {

void check(std::span<const FlexMeasurement> measurements) {
  const auto fail = [](size_t i, const char* what) {
    throw Error(ErrorCode::invalid_argument, "flex: measurement " + std::to_string(i) + " has " + what);
  };
  for (size_t i = 0; i < measurements.size(); ++i) {
    const FlexMeasurement& m = measurements[i];
    if (!std::isfinite(m.time) || (i > 0 && !(m.time > measurements[i - 1].time)))
      fail(i, "a time that is not later than the one before");
    if (!m.valid) continue;
    if (!m.T_rl.R.allFinite() || !m.T_rl.t.allFinite()) fail(i, "a pose that is not finite");
    if (!m.covariance.allFinite() || m.covariance.llt().info() != Eigen::Success)
      fail(i, "a covariance that is not positive definite");
  }
}

/// The costs of a state.
struct Costs {
  ceres::ResidualBlockId bound = nullptr, measurement = nullptr, to_next = nullptr;
};

/// The rows of the Jacobian of a state, weighted as in the solution.
internal::ChainLink link(const ceres::Problem& problem, const Costs& costs) {
  using Rows = Eigen::Matrix<double, 12, 12, Eigen::RowMajor>;
  Rows of_this, of_next;
  const auto evaluate = [&](ceres::ResidualBlockId id) {
    double cost = 0, residuals[12];
    double* jacobians[] = {of_this.data(), of_next.data()};
    problem.EvaluateResidualBlock(id, true, &cost, residuals, jacobians);
  };
  internal::ChainLink out;
  out.own.setZero(costs.measurement ? 18 : 12, 12);
  evaluate(costs.bound);
  out.own.topRows<12>() = of_this;
  if (costs.measurement) {
    evaluate(costs.measurement);
    out.own.bottomRows<6>() = of_this.topRows<6>();
  }
  if (costs.to_next) {
    evaluate(costs.to_next);
    out.to_next = of_this;
    out.next = of_next;
  }
  return out;
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
  using internal::State;
  State sigma;
  sigma.head<3>().setConstant(options.translation);
  sigma.segment<3>(3).setConstant(options.rotation);
  const double omega = 2 * std::numbers::pi * options.frequency;
  sigma.tail<6>() = omega * sigma.head<6>();
  // All measurements have equal weight in the mean, because the covariance of a measurement does not apply to other times.
  std::vector<internal::PoseVote> votes;
  for (const FlexMeasurement& m : measurements)
    if (m.valid) votes.push_back({m.T_rl, Matrix6d(sigma.head<6>().cwiseAbs2().asDiagonal()) + m.covariance, 0, 0});
  if (votes.empty()) return result;
  result.mean = internal::common_pose(votes);

  // An oscillation with standard deviation s has accelerations of s omega^2, which are correlated over about a quarter of its
  // period.
  const Vector6d density = (omega * omega * sigma.head<6>()).cwiseAbs2() / (4 * options.frequency);
  std::vector<State> states(measurements.size(), State::Zero());
  std::vector<Costs> costs(states.size());
  ceres::Problem problem;
  Vector6d last = Vector6d::Zero();
  for (size_t i = 0; i < states.size(); ++i) {
    const FlexMeasurement& m = measurements[i];
    if (m.valid) last = (result.mean.inverse() * m.T_rl).log();
    states[i].head<6>() = last;
    problem.AddParameterBlock(states[i].data(), 12);
    costs[i].bound = problem.AddResidualBlock(new internal::BoundCost(3 * sigma), nullptr, states[i].data());
    if (m.valid)
      costs[i].measurement =
          problem.AddResidualBlock(new internal::MeasurementCost(m.T_rl, m.covariance, result.mean),
                                   new ceres::CauchyLoss(std::sqrt(6.0) * options.cauchy_scale), states[i].data());
    if (i > 0)
      costs[i - 1].to_next = problem.AddResidualBlock(new internal::MotionCost(m.time - measurements[i - 1].time, density),
                                                      nullptr, states[i - 1].data(), states[i].data());
  }
  ceres::Solver::Options solver = internal::solver_options(options.iterations);
  solver.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);
  if (!summary.IsSolutionUsable()) return result;
  std::vector<internal::ChainLink> links;
  for (const Costs& c : costs) links.push_back(link(problem, c));
  const std::vector<internal::Matrix12d> covariances = internal::chain_covariances(links);
  for (size_t i = 0; i < states.size(); ++i) {
    const internal::Matrix12d& C = covariances[i];
    if (!C.allFinite()) return {.usable = false, .mean = result.mean, .states = {}};
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
