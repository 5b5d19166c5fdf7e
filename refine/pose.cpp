#include <iclk/refine/pose.h>

#include <algorithm>
#include <cmath>

#include <Eigen/Eigenvalues>
#include <ceres/ceres.h>

#include <iclk/refine/internal/options_check.h>
#include <iclk/refine/internal/reprojection.h>

namespace iclk {
namespace {

/// Scales of the Cauchy loss, from one that the start's residuals are at home in down to the wanted one: a loss of 0.3 px alone sees
/// only outliers from a start that is 3 px off, and would settle on whichever few features agree first.
std::vector<double> scales(std::vector<double> norms, double last) {
  std::nth_element(norms.begin(), norms.begin() + static_cast<std::ptrdiff_t>(norms.size() / 2), norms.end());
  std::vector<double> s;
  for (double scale = norms[norms.size() / 2]; std::isfinite(scale) && scale > 1.5 * last; scale /= 3) s.push_back(scale);
  s.push_back(last);
  return s;
}

/// Smallest eigenvalue of H scaled to a unit diagonal; 0 for a zero or non-finite diagonal. Units of rho and phi drop out.
double conditioning(const Matrix6d& H) {
  const Vector6d d = H.diagonal();
  if (!H.allFinite() || !(d.minCoeff() > 0)) return 0;
  const Vector6d s = d.cwiseSqrt().cwiseInverse();
  return Eigen::SelfAdjointEigenSolver<Matrix6d>(s.asDiagonal() * H * s.asDiagonal(), Eigen::EigenvaluesOnly).eigenvalues()[0];
}

}  // namespace

void PoseOptions::check() const {
  check_range("pose cauchy_scale", cauchy_scale, 1e-6, 1e6);
  check_range("pose min_sigma", min_sigma, 1e-6, 1e3);
  check_range("pose iterations", iterations, 1, 10000);
  check_range("pose min_features", min_features, 4, 1e6);
  check_range("pose inlier_distance", inlier_distance, 1e-3, 1e3);
  check_range("pose min_inlier_share", min_inlier_share, 0, 1);
}

Eigen::Matrix<double, 2, 6> reprojection_jacobian(const Camera& camera, const SE3& T_10, const Eigen::Vector3d& X0) {
  Eigen::Matrix<double, 3, 6> dX1;
  dX1 << T_10.R, -T_10.R * hat(X0);
  return camera.project_jacobian(T_10 * X0) * dX1;
}

PoseResult refine_pose(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned, const SE3& T_10,
                       const PoseOptions& options) {
  options.check();
  const std::vector<internal::Observation> used = internal::observations(camera, features, aligned, T_10, options.min_sigma);
  PoseResult result;
  result.T_10 = T_10;
  result.used = static_cast<int>(used.size());
  const std::vector<double> start = internal::residual_norms(camera, used, T_10);
  result.initial_cost = result.cost = internal::cauchy_cost(start, options.cauchy_scale);
  if (result.used < options.min_features) {
    result.status = Status::too_few_features;
    result.reason = std::to_string(result.used) + " aligned features, " + std::to_string(options.min_features) + " needed";
    return result;
  }

  internal::PoseBlock pose = internal::to_block(T_10);
  std::vector<double> q;
  for (const auto& o : used) q.push_back(o.q);
  ceres::LossFunctionWrapper loss(nullptr, ceres::TAKE_OWNERSHIP);
  ceres::Problem::Options ownership;
  ownership.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem problem(ownership);
  problem.AddParameterBlock(pose.data(), 12, new internal::PoseManifold);
  for (size_t i = 0; i < used.size(); ++i) {
    problem.AddResidualBlock(new internal::ReprojectionCost(camera, used[i].uv0, used[i].uv1, used[i].W), &loss, pose.data(), &q[i]);
    problem.SetParameterBlockConstant(&q[i]);
  }
  ceres::Solver::Options solver = internal::solver_options(options.iterations);
  solver.linear_solver_type = ceres::DENSE_QR;
  ceres::Solver::Summary summary;
  for (double scale : scales(start, options.cauchy_scale)) {
    loss.Reset(new ceres::CauchyLoss(scale), ceres::TAKE_OWNERSHIP);
    ceres::Solve(solver, &problem, &summary);
    result.iterations += summary.num_successful_steps + summary.num_unsuccessful_steps;
    if (!summary.IsSolutionUsable()) break;
  }
  result.report = summary.BriefReport();
  result.T_10 = internal::to_pose(pose.data());
  if (result.T_10.R.allFinite()) result.T_10.orthonormalize();
  if (!internal::judge(used, camera, summary, options, result)) return result;

  const std::vector<double> norms = internal::residual_norms(camera, used, result.T_10);
  Matrix6d H = Matrix6d::Zero();
  for (size_t i = 0; i < used.size(); ++i) {
    const Eigen::Matrix<double, 2, 6> J = used[i].W * reprojection_jacobian(camera, result.T_10, camera.ray(used[i].uv0) / used[i].q);
    H += J.transpose() * J / (1 + norms[i] * norms[i] / (options.cauchy_scale * options.cauchy_scale));
  }
  constexpr double kSingular = 1e-10;
  ceres::Covariance::Options covariance_options;
  covariance_options.algorithm_type = ceres::DENSE_SVD;
  ceres::Covariance covariance(covariance_options);
  const double condition = conditioning(H);
  const std::vector<std::pair<const double*, const double*>> blocks{{pose.data(), pose.data()}};
  if (!(condition > kSingular) || !covariance.Compute(blocks, &problem)) {
    result.status = Status::degenerate;
    result.reason = "the aligned features do not determine the pose: smallest scaled eigenvalue " + std::to_string(condition);
    return result;
  }
  Eigen::Matrix<double, 6, 6, Eigen::RowMajor> C;
  covariance.GetCovarianceBlockInTangentSpace(pose.data(), pose.data(), C.data());
  result.covariance = C * internal::variance_factor(norms, options.cauchy_scale, 6);
  return result;
}

}  // namespace iclk
