#include <iclk/refine/internal/structure.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include <ceres/ceres.h>
#include <Eigen/QR>

#include <iclk/align/common/options_check.h>
#include <iclk/refine/internal/reprojection.h>

namespace iclk::internal {
namespace {

std::vector<double> prior_sigmas(const Features& features, double relative_sigma) {
  std::vector<double> sigmas(features.uv.size(), 0.0);
  for (size_t i = 0; i < sigmas.size(); ++i) {
    const double q = features.inverse_depth[i];
    if (!std::isfinite(q) || q <= 0) continue;
    const double given = features.inverse_depth_sigma.empty() ? 0 : features.inverse_depth_sigma[i];
    sigmas[i] = std::isfinite(given) && given > 0 ? given : relative_sigma * q;
  }
  return sigmas;
}

/// The standard deviation, px, of the positions across their epipolar lines, where depth errors have no effect. It is 1.4826
/// times the median of |residual|, scaled up for the six parameters that were estimated from the same residuals.
double across_epipolar_sigma(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                             const SE3& T_10, const PoseOptions& options) {
  std::vector<double> across;
  for (const Observation& o : observations(camera, features, aligned, T_10, options.sigma)) {
    const Eigen::Vector3d p = T_10.R * camera.ray(o.uv0) + o.q * T_10.t;
    const Eigen::Vector2d along = camera.project_jacobian(p) * T_10.t;  // du1 / dq
    const double length = along.norm();
    const Eigen::Vector2d normal = length > 0 ? Eigen::Vector2d(-along.y(), along.x()) / length : Eigen::Vector2d(1, 0);
    across.push_back(std::abs(normal.dot(o.W * (camera.project(p) - o.uv1))));
  }
  std::nth_element(across.begin(), across.begin() + static_cast<std::ptrdiff_t>(across.size() / 2), across.end());
  const double n = static_cast<double>(across.size());
  return 1.4826 * across[across.size() / 2] * std::sqrt(2 * n / std::max(2 * n - 6, 1.0));
}

}  // namespace

void StructureOptions::check() const {
  pose.check();
  check_range("structure relative_sigma", relative_sigma, 1e-6, 10);
}

namespace {

/// The costs of a feature: its sighting, and the prior of its depth.
struct FeatureCosts {
  ceres::ResidualBlockId reprojection;
  double prior;
};

/// The covariance of the pose, and the variance of each depth.
struct StarCovariance {
  Matrix6d pose;
  std::vector<double> depths;
};

/// (J^T J)^-1 of a problem in which each depth is coupled only to the pose. QR eliminates each depth in its own rows. Nothing
/// if the rest does not determine the pose; ceres::Covariance would print to stderr then.
std::optional<StarCovariance> star_covariance(const ceres::Problem& problem, const std::vector<FeatureCosts>& costs) {
  const auto n = static_cast<Eigen::Index>(costs.size());
  Eigen::Matrix<double, Eigen::Dynamic, 6> rest(3 * n, 6), of_depth(n, 6);
  Eigen::VectorXd length(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const FeatureCosts& c = costs[static_cast<size_t>(i)];
    Eigen::Matrix<double, 2, 6, Eigen::RowMajor> by_pose = Eigen::Matrix<double, 2, 6, Eigen::RowMajor>::Zero();
    Eigen::Vector3d q(0, 0, c.prior);
    double cost = 0, residuals[2], *jacobians[] = {by_pose.data(), q.data()};
    problem.EvaluateResidualBlock(c.reprojection, true, &cost, residuals, jacobians);
    length[i] = q.stableNorm();
    q /= length[i];
    of_depth.row(i) = q.head<2>().transpose() * by_pose;
    rest.middleRows<3>(3 * i) = -q * of_depth.row(i);
    rest.middleRows<2>(3 * i) += by_pose;
  }
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(rest);
  if (!rest.allFinite() || qr.rank() < 6) return {};
  const Matrix6d inverse =
      qr.colsPermutation() *
      Matrix6d(qr.matrixR().topRows<6>().triangularView<Eigen::Upper>().solve(Eigen::MatrixXd::Identity(6, 6)));
  StarCovariance out{inverse * inverse.transpose(), {}};
  for (Eigen::Index i = 0; i < n; ++i)
    out.depths.push_back((1 + (of_depth.row(i) * inverse).squaredNorm()) / (length[i] * length[i]));
  return out;
}

// refine_structure() in the unit in which inverse depths are about 1.
StructureResult refine_unit_structure(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                                      const SE3& T_10, const StructureOptions& options) {
  StructureResult result;
  // First the pose alone: it rejects outliers that a free depth would explain.
  result.pose = refine_pose(camera, features, aligned, T_10, options.pose);
  result.inverse_depth = features.inverse_depth;
  result.inverse_depth_sigma = prior_sigmas(features, options.relative_sigma);
  if (!usable(result.pose.status)) return result;

  // The error of the positions determines the weight of the priors, so it is measured first. The floor is for exact data.
  const double sigma_0 =
      std::max(options.pose.min_sigma, across_epipolar_sigma(camera, features, aligned, result.pose.T_10, options.pose));
  const double scale = options.pose.cauchy_scale * sigma_0;
  std::vector<Observation> used = observations(camera, features, aligned, result.pose.T_10, sigma_0);
  PoseBlock pose = to_block(result.pose.T_10);
  ceres::Problem problem;
  problem.AddParameterBlock(pose.data(), 12, new PoseManifold);
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  ordering->AddElementToGroup(pose.data(), 1);
  std::vector<FeatureCosts> costs;
  for (Observation& o : used) {
    const double sigma_q = result.inverse_depth_sigma[o.feature];
    costs.push_back({problem.AddResidualBlock(new ReprojectionCost(camera, camera.ray(o.uv0), o.uv1, o.W),
                                              new ceres::CauchyLoss(scale), pose.data(), &o.q),
                     sigma_0 / sigma_q});
    problem.AddResidualBlock(new DepthPriorCost(o.q, costs.back().prior), nullptr, &o.q);
    problem.SetParameterLowerBound(&o.q, 0, 1e-3 * o.q);  // a depth stays in front of the camera
    ordering->AddElementToGroup(&o.q, 0);
  }
  ceres::Solver::Options solver = solver_options(options.pose.iterations);
  solver.linear_solver_type = ceres::DENSE_SCHUR;
  solver.linear_solver_ordering = ordering;
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);

  PoseResult& p = result.pose;
  const PoseResult pose_only = p;
  p.covariance.setZero();
  const Ending end = ending(summary);
  p.iterations += end.iterations;
  p.T_10 = to_pose(pose.data());
  if (p.T_10.R.allFinite()) p.T_10.orthonormalize();
  if (!judge(used, camera, end, options.pose, scale, p)) {
    if (!end.usable) p.T_10 = pose_only.T_10;
    return result;
  }
  for (const Observation& o : used) result.inverse_depth[o.feature] = o.q;

  const auto covariance = star_covariance(problem, costs);
  if (!covariance) {
    p.status = Status::degenerate;
    p.reason = "the aligned features do not determine pose and inverse depths";
    return result;
  }
  // Priors and positions are in units of the measured sigma_0, so it is the scale of the whole system.
  p.covariance = sigma_0 * sigma_0 * covariance->pose + pose_only.shared;
  for (size_t i = 0; i < used.size(); ++i)
    result.inverse_depth_sigma[used[i].feature] = sigma_0 * std::sqrt(covariance->depths[i]);
  return result;
}

}  // namespace

StructureResult refine_structure(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                                 const SE3& T_10, const StructureOptions& options) {
  options.check();
  const double unit = unit_of(features);
  StructureResult result = refine_unit_structure(camera, in_unit(features, unit), aligned, in_unit(T_10, unit), options);
  from_unit(unit, result.pose);
  for (size_t i = 0; i < result.inverse_depth.size(); ++i) {
    // Values that were not refined are returned unchanged, including NaN.
    const bool refined = result.inverse_depth[i] != features.inverse_depth[i] / unit;
    result.inverse_depth[i] =
        refined && std::isfinite(result.inverse_depth[i]) ? result.inverse_depth[i] * unit : features.inverse_depth[i];
    result.inverse_depth_sigma[i] *= unit;
  }
  return result;
}

}  // namespace iclk::internal
