#include <iclk/refine/internal/reprojection.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <sstream>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>

#include <iclk/engine/error.h>
#include <iclk/refine/internal/verdict.h>
#include <iclk/shaders/refine/refine.h>

namespace iclk::internal {
namespace {

using RowMajor6x12 = Eigen::Matrix<double, 6, 12, Eigen::RowMajor>;
using RowMajor12x6 = Eigen::Matrix<double, 12, 6, Eigen::RowMajor>;

/// The relative sigma of the inverse depth; 0: unknown.
double relative_sigma(const Features& features, size_t i) {
  if (features.inverse_depth_sigma.empty()) return 0;
  const double sigma = features.inverse_depth_sigma[i] / features.inverse_depth[i];
  return std::isfinite(sigma) && sigma > 0 ? sigma : 0;
}

}  // namespace

PoseBlock to_block(const SE3& T) {
  PoseBlock x;
  x << T.R.col(0), T.R.col(1), T.R.col(2), T.t;
  return x;
}

SE3 to_pose(const double* block) {
  SE3 T;
  T.R = Eigen::Map<const Eigen::Matrix3d>(block);
  T.t = Eigen::Map<const Eigen::Vector3d>(block + 9);
  return T;
}

bool PoseManifold::Plus(const double* x, const double* xi, double* x_plus_xi) const {
  const SE3 T = to_pose(x) * SE3::exp(Eigen::Map<const Vector6d>(xi));
  Eigen::Map<PoseBlock>{x_plus_xi} = to_block(T);
  return true;
}

bool PoseManifold::PlusJacobian(const double* x, double* jacobian) const {
  // T Exp(xi) = [R + R phi^, t + R rho] to first order.
  const Eigen::Matrix3d R = to_pose(x).R;
  RowMajor12x6 J = RowMajor12x6::Zero();
  for (int k = 0; k < 3; ++k) {
    const Eigen::Matrix3d dR = R * hat(Eigen::Vector3d::Unit(k));
    J.block<9, 1>(0, 3 + k) << dR.col(0), dR.col(1), dR.col(2);
  }
  J.block<3, 3>(9, 0) = R;
  Eigen::Map<RowMajor12x6>{jacobian} = J;
  return true;
}

bool PoseManifold::Minus(const double* y, const double* x, double* y_minus_x) const {
  Eigen::Map<Vector6d>{y_minus_x} = (to_pose(x).inverse() * to_pose(y)).log();
  return true;
}

bool PoseManifold::MinusJacobian(const double* x, double* jacobian) const {
  // The left inverse of PlusJacobian: rho = R^T dt, phi from the skew part of R^T dR.
  const Eigen::Matrix3d R = to_pose(x).R;
  RowMajor6x12 J = RowMajor6x12::Zero();
  for (int k = 0; k < 3; ++k) {
    const Eigen::Matrix3d dR = 0.5 * R * hat(Eigen::Vector3d::Unit(k));
    J.block<1, 9>(3 + k, 0) << dR.col(0).transpose(), dR.col(1).transpose(), dR.col(2).transpose();
  }
  J.block<3, 3>(0, 9) = R.transpose();
  Eigen::Map<RowMajor6x12>{jacobian} = J;
  return true;
}

bool ReprojectionCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const SE3 T = to_pose(parameters[0]);
  const double q = parameters[1][0];
  const Eigen::Vector3d p = T.R * ray_ + q * T.t;
  if (!(p.z() > least_depth_)) return false;  // Ceres rejects the step
  Eigen::Map<Eigen::Vector2d>{residuals} = W_ * (camera_.project(p) - uv1_);
  if (jacobians == nullptr) return true;
  const Eigen::Matrix<double, 2, 3> J = W_ * camera_.project_jacobian(p);
  if (jacobians[0] != nullptr) {
    Eigen::Map<Eigen::Matrix<double, 2, 12, Eigen::RowMajor>> J_pose(jacobians[0]);
    for (int k = 0; k < 3; ++k) J_pose.block<2, 3>(0, 3 * k) = J * ray_[k];
    J_pose.block<2, 3>(0, 9) = J * q;
  }
  if (jacobians[1] != nullptr) Eigen::Map<Eigen::Vector2d>{jacobians[1]} = J * T.t;
  return true;
}

double unit_of(const Features& features) {
  double sum = 0;
  int n = 0;
  for (double q : features.inverse_depth)
    if (std::isfinite(q) && q > 1e-100 && q < 1e100) {
      sum += q;
      ++n;
    }
  return n > 0 ? sum / n : 1;
}

Features in_unit(const Features& features, double unit) {
  Features scaled = features;
  for (double& q : scaled.inverse_depth) q /= unit;
  for (double& sigma : scaled.inverse_depth_sigma) sigma /= unit;
  return scaled;
}

SE3 in_unit(const SE3& T_10, double unit) { return {T_10.R, T_10.t * unit}; }

void from_unit(double unit, PoseResult& result) {
  result.T_10.t /= unit;
  for (Matrix6d* covariance : {&result.covariance, &result.shared}) {
    covariance->topRows<3>() /= unit;
    covariance->leftCols<3>() /= unit;
  }
}

Eigen::Matrix2d whitening(const Eigen::Matrix2d& covariance, double sigma_0) {
  const Eigen::Matrix2d C = covariance + sigma_0 * sigma_0 * Eigen::Matrix2d::Identity();
  return sigma_0 * Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(C).operatorInverseSqrt();
}

std::vector<Observation> observations(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                                      const SE3& T_10, double sigma_0) {
  camera.check();
  if (aligned.size() != features.uv.size())
    throw Error(ErrorCode::invalid_argument, std::to_string(aligned.size()) + " aligned features for " +
                                                 std::to_string(features.uv.size()) + " features of the reference");
  if (!T_10.R.allFinite() || !T_10.t.allFinite())
    throw Error(ErrorCode::invalid_argument, "the pose to refine has an entry that is not finite");
  const std::vector<FeatureCheck> checks = check_features(features, camera);
  std::vector<Observation> used;
  for (size_t i = 0; i < aligned.size(); ++i) {
    const AlignedFeature& a = aligned[i];
    if (a.status != FeatureStatus::aligned || checks[i] != FeatureCheck::ok) continue;
    const double q = features.inverse_depth[i];
    const Eigen::Vector3d p = T_10.R * camera.ray(features.uv[i]) + q * T_10.t;
    const Eigen::Matrix2d W = whitening(a.covariance, sigma_0);
    if (p.z() > kMinDepth && a.uv1.allFinite() && W.allFinite())
      used.push_back({static_cast<int>(i), features.uv[i], a.uv1, q, relative_sigma(features, i), a.covariance, W});
  }
  return used;
}

std::optional<Eigen::Vector2d> residual(const Camera& camera, const Observation& o, const SE3& T_10) {
  const Eigen::Vector3d p = T_10.R * camera.ray(o.uv0) + o.q * T_10.t;
  if (!(p.z() > kMinDepth)) return std::nullopt;
  return camera.project(p) - o.uv1;
}

std::vector<double> residual_norms(const Camera& camera, std::span<const Observation> observations, const SE3& T_10) {
  std::vector<double> norms;
  norms.reserve(observations.size());
  for (const Observation& o : observations) {
    const auto r = residual(camera, o, T_10);
    norms.push_back(r ? (o.W * *r).norm() : std::numeric_limits<double>::infinity());
  }
  return norms;
}

double cauchy_cost(std::span<const double> norms, double scale) {
  double sum = 0;
  for (double r : norms) sum += 0.5 * scale * scale * std::log1p(r * r / (scale * scale));
  return norms.empty() ? 0 : sum / static_cast<double>(norms.size());
}

double variance_factor(std::span<const double> norms, double scale, int parameters) {
  if (norms.empty()) return 0;
  double psi2 = 0, w1 = 0, w2 = 0;
  for (double r : norms) {
    const double w = std::isfinite(r) ? 1 / (1 + r * r / (scale * scale)) : 0;
    if (w > 0) psi2 += w * w * r * r;
    w1 += w;
    w2 += w * w;
  }
  const double n = static_cast<double>(norms.size());
  const double freedom = std::max(2 * n - parameters, 1.0);
  const double huber = w2 > 0 ? psi2 / freedom * (w1 / n) / (w2 * w2 / (n * n)) : 0;
  std::vector<double> sorted(norms.begin(), norms.end());
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  const double median =
      *middle * *middle / (2 * std::log(2.0)) * 2 * n / freedom;  // |r|^2 of a 2D Gaussian has the median 2 ln 2 sigma^2
  return std::max(huber, std::isfinite(median) ? median : 0.0);
}

ceres::Solver::Options solver_options(int iterations) {
  ceres::Solver::Options o;
  o.minimizer_type = ceres::TRUST_REGION;
  o.trust_region_strategy_type = ceres::LEVENBERG_MARQUARDT;
  o.max_num_iterations = iterations;
  o.num_threads = 1;  // the caller manages the threads
  o.logging_type = ceres::SILENT;
  o.minimizer_progress_to_stdout = false;
  o.function_tolerance = 1e-8;
  o.gradient_tolerance = 1e-10;
  o.parameter_tolerance = 1e-9;
  return o;
}

Ending ending(const ceres::Solver::Summary& summary) {
  return {summary.IsSolutionUsable(), summary.termination_type == ceres::CONVERGENCE,
          summary.num_successful_steps + summary.num_unsuccessful_steps, summary.message};
}

namespace {

/// The standard deviation of points across their best line.
double width_of(std::span<const Eigen::Vector2d> points) {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& p : points) mean += p / static_cast<double>(points.size());
  Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();
  for (const Eigen::Vector2d& p : points) scatter += (p - mean) * (p - mean).transpose() / static_cast<double>(points.size());
  return std::sqrt(
      std::max(Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(scatter, Eigen::EigenvaluesOnly).eigenvalues()[0], 0.0));
}

}  // namespace

bool judge(std::span<const Observation> observations, const Camera& camera, const Ending& ending, const PoseOptions& options,
           double scale, PoseResult& result) {
  const std::vector<double> norms = residual_norms(camera, observations, result.T_10);
  result.cost = cauchy_cost(norms, scale);
  result.sigma = std::sqrt(variance_factor(norms, scale, 6));
  std::vector<Eigen::Vector2d> agree;
  for (const Observation& o : observations) {
    const auto r = residual(camera, o, result.T_10);
    if (r && r->norm() <= options.inlier_distance) agree.push_back(o.uv0);
  }
  result.inliers = static_cast<int>(agree.size());
  std::ostringstream why;
  why << inliers_text(result.inliers, result.used, options);
  if (!ending.usable || !result.T_10.R.allFinite() || !result.T_10.t.allFinite()) {
    result.status = Status::diverged;
    result.reason = "pose refinement failed: " + ending.message;
    return false;
  }
  if (result.inliers < options.min_inlier_share * result.used || result.inliers < options.min_features) {
    result.status = Status::diverged;
    why << ", " << std::max<double>(options.min_features, std::ceil(options.min_inlier_share * result.used)) << " needed";
    result.reason = why.str();
    return false;
  }
  if (const double width = width_of(agree); !(width >= ICLK_LEAST_WIDTH * camera.height)) {
    result.status = Status::degenerate;
    result.reason = std::to_string(result.inliers) + " features agree on the pose, but they lie on one line, " +
                    std::to_string(width) + " px wide: they may slide along it";
    return false;
  }
  result.status = ending.converged ? Status::converged : Status::max_iterations;
  if (result.status == Status::max_iterations) why << ", still moving after " << result.iterations << " iterations";
  result.reason = why.str();
  return true;
}

}  // namespace iclk::internal
