#include <iclk/refine/pose.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include <ceres/tiny_solver.h>
#include <Eigen/Eigenvalues>

#include <iclk/align/common/options_check.h>
#include <iclk/align/search/matching.h>
#include <iclk/align/search/p3p.h>
#include <iclk/refine/internal/uncertainty.h>
#include <iclk/shaders/refine/refine.h>

namespace iclk {
namespace {

/// The inverse of H, computed from H scaled to a unit diagonal, which removes the units of rho and phi.
struct Inverse {
  explicit Inverse(const Matrix6d& H) {
    const Vector6d d = H.diagonal();
    if (!H.allFinite() || !(d.minCoeff() > 0)) return;
    const Vector6d s = d.cwiseSqrt().cwiseInverse();
    const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(s.asDiagonal() * H * s.asDiagonal());
    smallest = eigen.eigenvalues()[0];
    const Matrix6d V = s.asDiagonal() * eigen.eigenvectors();
    matrix = V * eigen.eigenvalues().cwiseInverse().asDiagonal() * V.transpose();
  }
  Matrix6d matrix = Matrix6d::Zero();
  double smallest = 0;  ///< eigenvalue of H as scaled; 0 for a zero or non-finite diagonal
};

}  // namespace

void PoseOptions::check() const {
  check_range("pose cauchy_scale", cauchy_scale, 1e-6, 1e6);
  check_range("pose min_sigma", min_sigma, 1e-6, 1e3);
  check_range("pose sigma", sigma, min_sigma, max_sigma);
  check_range("pose max_sigma", max_sigma, min_sigma, 1e3);
  check_range("pose max_depth_sigma", max_depth_sigma, 0, 10);
  if (camera_sigma) check_range("pose camera_sigma", *camera_sigma, 0, 1e3);
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

namespace {

/// The residuals of the observations, which must outlive it, as a function of a step [rho, phi] from T_0 to T_0 [exp(phi^),
/// rho]. ceres::TinySolver has no loss functions. Therefore residuals and Jacobian are multiplied by the root of their weight,
/// as Ceres does for concave losses. A last residual without a Jacobian adds the difference between the loss and the squares.
class CauchyReprojection {
 public:
  using Scalar = double;
  enum { NUM_RESIDUALS = Eigen::Dynamic, NUM_PARAMETERS = 6 };

  CauchyReprojection(const Camera& camera, std::span<const internal::Observation> used, const SE3& T_0, double scale)
      : camera_(camera), used_(used), T_0_(T_0), scale_(scale) {
    for (const internal::Observation& o : used) rays_.push_back(camera.ray(o.uv0));
  }
  int NumResiduals() const { return 2 * static_cast<int>(used_.size()) + 1; }

  SE3 at(const double* step) const {
    const Eigen::Map<const Vector6d> xi(step);
    return T_0_ * SE3{exp(Eigen::Vector3d::Zero(), xi.tail<3>()).R, xi.head<3>()};
  }

  bool operator()(const double* step, double* residuals, double* jacobian) const {
    const SE3 T = at(step);
    const Eigen::Matrix3d J_r = right_jacobian(Eigen::Map<const Vector6d>(step).tail<3>());
    Eigen::Map<Eigen::VectorXd> r(residuals, NumResiduals());
    Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, 6>> J(jacobian, NumResiduals(), 6);
    double rest = 0;
    for (size_t i = 0; i < used_.size(); ++i) {
      const internal::Observation& o = used_[i];
      const Eigen::Vector3d p = T.R * rays_[i] + o.q * T.t;
      if (!(p.z() > internal::kMinDepth)) {  // such steps are rejected
        r.setConstant(std::numeric_limits<double>::infinity());
        return false;
      }
      const Eigen::Vector2d white = o.W * (camera_.project(p) - o.uv1);
      const double square = white.squaredNorm() / (scale_ * scale_), weight = 1 / (1 + square);
      rest += std::max(std::log1p(square) - weight * square, 0.0);
      const auto row = static_cast<Eigen::Index>(2 * i);
      r.segment<2>(row) = std::sqrt(weight) * white;
      if (jacobian == nullptr) continue;
      Eigen::Matrix<double, 3, 6> dp;
      dp << o.q * T_0_.R, -T.R * hat(rays_[i]) * J_r;
      J.middleRows<2>(row) = std::sqrt(weight) * o.W * camera_.project_jacobian(p) * dp;
    }
    r.tail<1>()[0] = scale_ * std::sqrt(rest);
    if (jacobian != nullptr) J.bottomRows<1>().setZero();
    return true;
  }

 private:
  static SE3 exp(const Eigen::Vector3d& rho, const Eigen::Vector3d& phi) {
    return SE3::exp((Vector6d() << rho, phi).finished());
  }
  /// exp((phi + d)^) ~ exp(phi^) exp((J_r d)^): V of Exp, transposed.
  static Eigen::Matrix3d right_jacobian(const Eigen::Vector3d& phi) {
    Eigen::Matrix3d J;
    for (int k = 0; k < 3; ++k) J.row(k) = exp(Eigen::Vector3d::Unit(k), phi).t.transpose();
    return J;
  }

  const Camera& camera_;
  std::span<const internal::Observation> used_;
  SE3 T_0_;
  double scale_;
  std::vector<Eigen::Vector3d> rays_;
};

struct Solution {
  SE3 T_10;
  internal::Ending ending;
};

Solution solve(const Camera& camera, std::span<const internal::Observation> used, const SE3& T_10, double scale,
               int iterations) {
  const CauchyReprojection residuals(camera, used, T_10, scale);
  ceres::TinySolver<CauchyReprojection> solver{};  // {}: GCC 14 warns that a failing first residual would leave its cost unset
  Eigen::VectorXd first(residuals.NumResiduals());
  Vector6d step = Vector6d::Zero();
  Solution s{T_10, {.message = "a feature lies behind the camera"}};
  if (!residuals(step.data(), first.data(), nullptr)) return s;
  solver.options.max_num_iterations = iterations + 1;  // the last one takes no step
  solver.options.parameter_tolerance = 1e-9;
  solver.options.function_tolerance = 1e-8 * first.squaredNorm();
  solver.Solve(residuals, &step);
  s.T_10 = residuals.at(step.data());
  s.ending = {.usable = s.T_10.R.allFinite() && s.T_10.t.allFinite(),
              .converged = solver.summary.status != ceres::TinySolver<CauchyReprojection>::HIT_MAX_ITERATIONS,
              .iterations = std::min(solver.summary.iterations, iterations),
              .message = "the pose is not finite"};
  if (s.ending.usable) s.T_10.orthonormalize();
  return s;
}

constexpr double kSharp = ICLK_SHARP, kClearlyBetter = ICLK_CLEARLY_BETTER;

/// The sum of log(1 + r^2 / scale^2), or any number that is not less than `enough`.
double log_cost(const Camera& camera, std::span<const internal::Observation> used, const SE3& T_10, double scale,
                double enough) {
  internal::LogSum sum;
  for (const internal::Observation& o : used) {
    const auto r = internal::residual(camera, o, T_10);
    if (!r || sum.least() >= enough) return std::numeric_limits<double>::infinity();
    sum.add(1 + (o.W * *r).squaredNorm() / (scale * scale));
  }
  return sum.value();
}

/// The pose with the least cost among poses from three features each. If many depths are wrong, a descent from the pose of all
/// features ends between the right ones and the wrong ones.
std::optional<SE3> consensus(const Camera& camera, std::span<const internal::Observation> used, double scale) {
  constexpr uint32_t kHypotheses = 64;  // with 40 % wrong features, 13 of them use only right ones
  const auto count = static_cast<uint32_t>(used.size());
  std::optional<SE3> best;
  double least = std::numeric_limits<double>::infinity();
  for (uint32_t h = 0; h < kHypotheses; ++h) {
    const auto [i, j, k] = internal::three_of(count, h);
    const auto point = [&](uint32_t n) -> Eigen::Vector3d { return camera.ray(used[n].uv0) / used[n].q; };
    const auto ray = [&](uint32_t n) { return camera.ray(used[n].uv1); };
    for (const SE3& T : internal::p3p({point(i), point(j), point(k)}, {ray(i), ray(j), ray(k)})) {
      const double cost = log_cost(camera, used, T, scale, least);
      if (cost < least) least = cost, best = T;
    }
  }
  return best;
}

// refine_pose() in the unit in which inverse depths are about 1.
PoseResult refine_unit_pose(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                            const SE3& T_10, const PoseOptions& options) {
  std::vector<internal::Observation> used = internal::observations(camera, features, aligned, T_10, options.sigma);
  PoseResult result;
  result.T_10 = T_10;
  result.used = static_cast<int>(used.size());
  result.floor = options.sigma;
  internal::whiten(camera, used, T_10, {options.sigma, 0});
  double scale = options.cauchy_scale * options.sigma;
  const auto cost_at = [&](const SE3& T) { return internal::cauchy_cost(internal::residual_norms(camera, used, T), scale); };
  result.initial_cost = result.cost = cost_at(T_10);
  if (result.used < options.min_features) {
    result.status = Status::too_few_features;
    result.reason = std::to_string(result.used) + " aligned features, " + std::to_string(options.min_features) + " needed";
    return result;
  }

  // The scale needs no continuation: from 100 px off and with 45 % outliers, the final scale alone converges as often, in half
  // the steps.
  Solution first = solve(camera, used, T_10, scale, options.iterations);
  if (const std::optional<SE3> T = consensus(camera, used, kSharp)) {
    const Solution other = solve(camera, used, *T, kSharp, options.iterations);
    const auto mean_log = [&](const SE3& at) {
      return internal::cauchy_cost(internal::residual_norms(camera, used, at), kSharp) / (0.5 * kSharp * kSharp);
    };
    if (other.ending.usable && mean_log(other.T_10) < mean_log(first.T_10) - kClearlyBetter) first = other;
  }
  if (first.ending.usable) {
    result.T_10 = first.T_10;
    result.iterations = first.ending.iterations;
    const internal::PositionErrors errors = internal::position_errors(camera, used, result.T_10, options);
    result.floor = errors.floor;
    result.depth_sigma = errors.relative_depth;
    scale = options.cauchy_scale * result.floor;
    internal::whiten(camera, used, result.T_10, errors);
    result.initial_cost = cost_at(T_10);
  }
  const Solution last = solve(camera, used, result.T_10, scale, options.iterations);
  result.T_10 = last.T_10;
  result.iterations += last.ending.iterations;
  if (!internal::judge(used, camera, last.ending, options, scale, result)) return result;

  const std::vector<double> norms = internal::residual_norms(camera, used, result.T_10);
  Matrix6d H = Matrix6d::Zero();
  for (size_t i = 0; i < used.size(); ++i) {
    const Eigen::Matrix<double, 2, 6> J =
        used[i].W * reprojection_jacobian(camera, result.T_10, camera.ray(used[i].uv0) / used[i].q);
    H += J.transpose() * J / (1 + norms[i] * norms[i] / (scale * scale));
  }
  constexpr double kSingular = 1e-10;
  const Inverse inverse(H);
  if (!(inverse.smallest > kSingular)) {
    result.status = Status::degenerate;
    result.reason =
        "the aligned features do not determine the pose: smallest scaled eigenvalue " + std::to_string(inverse.smallest);
    return result;
  }
  const internal::SharedErrors shared =
      internal::shared_errors(camera, used, result.T_10, scale, result.depth_sigma, options.camera_sigma);
  result.calibration_sigma = shared.calibration;
  result.shared = shared.covariance;
  result.covariance = inverse.matrix * internal::variance_factor(norms, scale, 6) + shared.covariance;
  return result;
}

}  // namespace

PoseResult refine_pose(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned, const SE3& T_10,
                       const PoseOptions& options) {
  options.check();
  const double unit = internal::unit_of(features);
  PoseResult result =
      refine_unit_pose(camera, internal::in_unit(features, unit), aligned, internal::in_unit(T_10, unit), options);
  internal::from_unit(unit, result);
  return result;
}

}  // namespace iclk
