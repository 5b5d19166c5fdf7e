#include <iclk/refine/structure.h>

#include <algorithm>
#include <cmath>

#include <ceres/ceres.h>

#include <iclk/align/common/options_check.h>
#include <iclk/refine/internal/reprojection.h>

namespace iclk {
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

/// Standard deviation, px, of the positions across their epipolar lines, where no depth error shows: 1.4826 times the median of
/// |residual|, scaled up for the six parameters that the same residuals determined.
double across_epipolar_sigma(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                             const SE3& T_10, const PoseOptions& options) {
  std::vector<double> across;
  for (const internal::Observation& o : internal::observations(camera, features, aligned, T_10, options.sigma)) {
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

// refine_structure() in the unit in which inverse depths are about 1.
StructureResult refine_unit_structure(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                                      const SE3& T_10, const StructureOptions& options) {
  StructureResult result;
  // The pose alone first: it weeds out what a free depth would explain away.
  result.pose = refine_pose(camera, features, aligned, T_10, options.pose);
  result.inverse_depth = features.inverse_depth;
  result.inverse_depth_sigma = prior_sigmas(features, options.relative_sigma);
  if (!usable(result.pose.status)) return result;

  // How wrong the positions are decides what the priors weigh, so it is measured first; the floor holds for exact data.
  const double sigma_0 =
      std::max(options.pose.min_sigma, across_epipolar_sigma(camera, features, aligned, result.pose.T_10, options.pose));
  const double scale = options.pose.cauchy_scale * sigma_0;
  std::vector<internal::Observation> used = internal::observations(camera, features, aligned, result.pose.T_10, sigma_0);
  internal::PoseBlock pose = internal::to_block(result.pose.T_10);
  ceres::Problem problem;
  problem.AddParameterBlock(pose.data(), 12, new internal::PoseManifold);
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  ordering->AddElementToGroup(pose.data(), 1);
  for (internal::Observation& o : used) {
    const double sigma_q = result.inverse_depth_sigma[o.feature];
    problem.AddResidualBlock(new internal::ReprojectionCost(camera, camera.ray(o.uv0), o.uv1, o.W),
                             new ceres::CauchyLoss(scale), pose.data(), &o.q);
    problem.AddResidualBlock(new internal::DepthPriorCost(o.q, sigma_0 / sigma_q), nullptr, &o.q);
    problem.SetParameterLowerBound(&o.q, 0, 1e-3 * o.q);  // a depth stays in front of the camera
    ordering->AddElementToGroup(&o.q, 0);
  }
  ceres::Solver::Options solver = internal::solver_options(options.pose.iterations);
  solver.linear_solver_type = ceres::DENSE_SCHUR;
  solver.linear_solver_ordering = ordering;
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);

  PoseResult& p = result.pose;
  const PoseResult pose_only = p;
  p.covariance.setZero();
  const internal::Ending ending = internal::ending(summary);
  p.iterations += ending.iterations;
  p.T_10 = internal::to_pose(pose.data());
  if (p.T_10.R.allFinite()) p.T_10.orthonormalize();
  if (!internal::judge(used, camera, ending, options.pose, scale, p)) {
    if (!ending.usable) p.T_10 = pose_only.T_10;
    return result;
  }
  for (const internal::Observation& o : used) result.inverse_depth[o.feature] = o.q;

  std::vector<std::pair<const double*, const double*>> blocks{{pose.data(), pose.data()}};
  for (const internal::Observation& o : used) blocks.emplace_back(&o.q, &o.q);
  ceres::Covariance::Options covariance_options;
  covariance_options.algorithm_type = ceres::SPARSE_QR;
  ceres::Covariance covariance(covariance_options);
  if (!covariance.Compute(blocks, &problem)) {
    p.status = Status::degenerate;
    p.reason = "the aligned features do not determine pose and inverse depths";
    return result;
  }
  // Priors and positions are in units of sigma_0, which was measured: it is the scale of the whole system.
  const double variance = sigma_0 * sigma_0;
  Eigen::Matrix<double, 6, 6, Eigen::RowMajor> C;
  covariance.GetCovarianceBlockInTangentSpace(pose.data(), pose.data(), C.data());
  p.covariance = variance * C + pose_only.shared;
  for (const internal::Observation& o : used) {
    double c = 0;
    covariance.GetCovarianceBlock(&o.q, &o.q, &c);
    result.inverse_depth_sigma[o.feature] = std::sqrt(variance * c);
  }
  return result;
}

}  // namespace

StructureResult refine_structure(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                                 const SE3& T_10, const StructureOptions& options) {
  options.check();
  const double unit = internal::unit_of(features);
  StructureResult result =
      refine_unit_structure(camera, internal::in_unit(features, unit), aligned, internal::in_unit(T_10, unit), options);
  internal::from_unit(unit, result.pose);
  for (size_t i = 0; i < result.inverse_depth.size(); ++i) {
    // What was not refined comes back to the bit, NaN included.
    const bool refined = result.inverse_depth[i] != features.inverse_depth[i] / unit;
    result.inverse_depth[i] =
        refined && std::isfinite(result.inverse_depth[i]) ? result.inverse_depth[i] * unit : features.inverse_depth[i];
    result.inverse_depth_sigma[i] *= unit;
  }
  return result;
}

}  // namespace iclk
