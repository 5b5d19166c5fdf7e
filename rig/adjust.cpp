#include <iclk/rig/adjust.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <memory>

#include <ceres/ceres.h>
#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>

#include <iclk/align/common/options_check.h>
#include <iclk/engine/error.h>
#include <iclk/refine/internal/reprojection.h>
#include <iclk/rig/internal/costs.h>

namespace iclk {
namespace {

constexpr int kLeast = 8;  // sightings

/// A sighting that is used, by its index.
struct Used {
  size_t index;
  Eigen::Vector3d ray;
  double q, q0;
  Eigen::Matrix2d W;
};

struct Problem {
  const Camera& right;
  std::span<const RigSighting> sightings;
  const RigAdjustOptions& options;
  std::vector<Used> used;
  SE3 T;

  void whiten(double floor) {
    for (Used& u : used) u.W = internal::whitening(sightings[u.index].covariance, floor) / floor;
  }

  bool solve(int& iterations) {
    internal::PoseBlock pose = internal::to_block(T);
    ceres::Problem problem;
    problem.AddParameterBlock(pose.data(), 12, new internal::PoseManifold);
    auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
    ordering->AddElementToGroup(pose.data(), 1);
    for (Used& u : used) {
      const RigSighting& s = sightings[u.index];
      problem.AddResidualBlock(new internal::ReprojectionCost(right, u.ray, s.right, u.W, internal::kLeastDepth),
                               new ceres::CauchyLoss(options.cauchy_scale), pose.data(), &u.q);
      problem.SetParameterLowerBound(&u.q, 0, 1e-4 * u.q0);
      if (s.inverse_depth_sigma > 0)
        problem.AddResidualBlock(new internal::DepthPriorCost(u.q0, 1 / s.inverse_depth_sigma), nullptr, &u.q);
      ordering->AddElementToGroup(&u.q, 0);
    }
    if (options.baseline_sigma > 0)
      problem.AddResidualBlock(new internal::BaselineCost(options.baseline, options.baseline_sigma), nullptr, pose.data());
    ceres::Solver::Options solver = internal::solver_options(options.iterations);
    solver.linear_solver_type = ceres::DENSE_SCHUR;
    solver.linear_solver_ordering = ordering;
    ceres::Solver::Summary summary;
    ceres::Solve(solver, &problem, &summary);
    iterations += summary.num_successful_steps + summary.num_unsuccessful_steps;
    const SE3 found = internal::to_pose(pose.data());
    if (!summary.IsSolutionUsable() || !found.R.allFinite() || !found.t.allFinite()) return false;
    T = found;
    T.orthonormalize();
    return true;
  }

  Eigen::Vector3d point(const Used& u) const { return T.R * u.ray + u.q * T.t; }
  Eigen::Vector2d residual(const Used& u) const {
    const Eigen::Vector3d p = point(u);
    if (!(p.z() > internal::kLeastDepth)) return Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity());
    return right.project(p) - sightings[u.index].right;
  }

  /// 1.4826 times the median distance from the epipolar lines, px; depths do not affect it.
  double across() const {
    std::vector<double> distances;
    for (const Used& u : used) {
      const Eigen::Vector2d r = residual(u);
      if (!r.allFinite()) continue;
      const Eigen::Vector2d along = right.project_jacobian(point(u)) * T.t;
      const double length = along.norm();
      distances.push_back(length > 0 ? std::abs(along.x() * r.y() - along.y() * r.x()) / length : std::abs(r.y()));
    }
    if (distances.empty()) return 0;
    const auto middle = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2);
    std::nth_element(distances.begin(), middle, distances.end());
    const double n = static_cast<double>(distances.size());
    return 1.4826 * *middle * std::sqrt(n / std::max(n - 6, 1.0));
  }

  /// The sandwich A^-1 M A^-1 with M by features, and the factor by which M is larger by pairs. Returns false if A is singular.
  bool covariance(Matrix6d& C, double& inflation) const {
    Matrix6d A = Matrix6d::Zero(), M = Matrix6d::Zero();
    std::map<int, Vector6d> scores;
    Eigen::Matrix<double, 6, 3> shared = Eigen::Matrix<double, 6, 3>::Zero();  // scores of shared errors, for one sigma each
    for (const Used& u : used) {
      const Eigen::Vector3d p = point(u);
      if (!(p.z() > internal::kLeastDepth)) continue;
      const RigSighting& s = sightings[u.index];
      const Eigen::Vector2d r = u.W * residual(u);
      const double w = 1 / (1 + r.squaredNorm() / (options.cauchy_scale * options.cauchy_scale));
      // d p / d xi of T Exp(xi), p = R ray + q t.
      Eigen::Matrix<double, 3, 6> dp;
      dp << u.q * T.R, -T.R * hat(u.ray);
      const Eigen::Matrix<double, 2, 3> P = u.W * right.project_jacobian(p);
      const Eigen::Matrix<double, 2, 6> J = P * dp;
      const Eigen::Vector2d Jq = P * T.t;
      const double prior = s.inverse_depth_sigma > 0 ? 1 / (s.inverse_depth_sigma * s.inverse_depth_sigma) : 0;
      // psi' of the Cauchy loss in two dimensions is w^2 in the mean.
      const double qq = w * w * Jq.squaredNorm() + prior;
      const Vector6d Jtq = w * w * J.transpose() * Jq;
      A += w * w * J.transpose() * J;
      const Vector6d score = w * J.transpose() * r;  // the term of the inverse depth is zero at its optimum
      Eigen::Matrix<double, 2, 3> common;            // whitened residuals: right along u, along v
      common << options.shared_position * u.W, Eigen::Vector2d::Zero();
      Eigen::Vector3d common_prior(0, 0, prior > 0 ? options.shared_depth / s.inverse_depth_sigma : 0);
      shared += w * J.transpose() * common;
      if (qq > 0) {
        shared -= Jtq / qq * (w * Jq.transpose() * common - common_prior.transpose());
        A -= Jtq * Jtq.transpose() / qq;
      }
      M += score * score.transpose();
      auto [at, first] = scores.try_emplace(s.pair, Vector6d::Zero());
      at->second += score;
    }
    if (options.baseline_sigma > 0) {
      Vector6d J = Vector6d::Zero();
      J.head<3>() = T.R.transpose() * T.t.normalized() / options.baseline_sigma;
      A += J * J.transpose();
      M += J * J.transpose();
    }
    const Vector6d d = A.diagonal();
    if (!A.allFinite() || !(d.minCoeff() > 0)) return false;
    const Vector6d scale = d.cwiseSqrt().cwiseInverse();
    const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(scale.asDiagonal() * A * scale.asDiagonal());
    if (!(eigen.eigenvalues()[0] > 1e-10)) return false;
    const Matrix6d inverse = scale.asDiagonal() * eigen.eigenvectors() * eigen.eigenvalues().cwiseInverse().asDiagonal() *
                             eigen.eigenvectors().transpose() * scale.asDiagonal();
    const double n = static_cast<double>(used.size());
    C = n / std::max(n - 6, 1.0) * inverse * M * inverse;
    inflation = 1;
    if (const double pairs = static_cast<double>(scores.size()); pairs >= 4) {
      Matrix6d by_pairs = Matrix6d::Zero();
      for (const auto& [pair, score] : scores) by_pairs += score * score.transpose();
      inflation = std::max(1.0, pairs / (pairs - 1) * (M.ldlt().solve(by_pairs)).trace() / 6);
    }
    const Eigen::Matrix<double, 6, 3> moved = inverse * shared;
    C = (inflation * C + moved * moved.transpose()).eval();
    C = 0.5 * (C + C.transpose()).eval();
    return C.allFinite();
  }
};

void check(const Camera& left, const Camera& right, std::span<const RigSighting> sightings, const SE3& T_rl) {
  left.check();
  right.check();
  if (!T_rl.R.allFinite() || !T_rl.t.allFinite())
    throw Error(ErrorCode::invalid_argument, "rig: the initial T_rl is not finite");
  for (const RigSighting& s : sightings)
    if (s.pair < 0)
      throw Error(ErrorCode::invalid_argument, "rig: sighting of pair " + std::to_string(s.pair) + "; pairs count from 0");
}

}  // namespace

void RigAdjustOptions::check() const {
  check_range("rig min_floor", min_floor, 1e-6, 1e3);
  check_range("rig floor", floor, min_floor, max_floor);
  check_range("rig max_floor", max_floor, min_floor, 1e3);
  check_range("rig cauchy_scale", cauchy_scale, 1e-3, 1e6);
  check_range("rig inlier_distance", inlier_distance, 1e-3, 1e3);
  check_range("rig iterations", iterations, 1, 10000);
  check_range("rig shared_position", shared_position, 0, 1e3);
  check_range("rig shared_depth", shared_depth, 0, 1);
  check_range("rig baseline", baseline, 0, 1e9);
  check_range("rig baseline_sigma", baseline_sigma, 0, 1e9);
}

RigAdjustment adjust_rig(const Camera& left, const Camera& right, std::span<const RigSighting> sightings, const SE3& T_rl,
                         const RigAdjustOptions& options) {
  options.check();
  check(left, right, sightings, T_rl);
  RigAdjustment result;
  result.T_rl = T_rl;
  result.inverse_depth.resize(sightings.size());
  result.residual.assign(sightings.size(), std::numeric_limits<double>::infinity());
  Problem problem{right, sightings, options, {}, T_rl};
  for (size_t i = 0; i < sightings.size(); ++i) {
    const RigSighting& s = sightings[i];
    result.inverse_depth[i] = s.inverse_depth;
    const Eigen::Vector3d ray = left.ray(s.left);
    const double q = s.inverse_depth;
    if (!(q > 0) || !std::isfinite(q) || !ray.allFinite() || !s.right.allFinite() || !s.covariance.allFinite() ||
        !((T_rl.R * ray + q * T_rl.t).z() > 2 * internal::kLeastDepth) || !std::isfinite(s.inverse_depth_sigma))
      continue;
    problem.used.push_back({i, ray, q, q, Eigen::Matrix2d::Identity()});
  }
  result.used = static_cast<int>(problem.used.size());
  if (result.used < kLeast) return result;
  problem.whiten(options.floor);
  if (!problem.solve(result.iterations)) return result;
  problem.whiten(std::clamp(problem.across(), options.min_floor, options.max_floor));
  if (!problem.solve(result.iterations)) return result;
  result.sigma = problem.across();
  for (const Used& u : problem.used) {
    result.inverse_depth[u.index] = u.q;
    result.residual[u.index] = problem.residual(u).norm();
    result.inliers += result.residual[u.index] <= options.inlier_distance;
  }
  result.T_rl = problem.T;
  result.usable = problem.covariance(result.covariance, result.inflation);
  return result;
}

Rectification rectify(const SE3& T_rl) {
  const Eigen::Vector3d x = (-T_rl.R.transpose() * T_rl.t).normalized();
  const Eigen::Vector3d axes = Eigen::Vector3d::UnitZ() + T_rl.R.row(2).transpose();
  const Eigen::Vector3d y = axes.cross(x).normalized(), z = x.cross(y);
  Rectification r;
  r.left << x.transpose(), y.transpose(), z.transpose();
  r.right = r.left * T_rl.R.transpose();
  return r;
}

double rectified_error(const Camera& left, const Camera& right, const SE3& T_rl, const Eigen::Vector2d& uv_left,
                       const Eigen::Vector2d& uv_right) {
  const Rectification r = rectify(T_rl);
  const Eigen::Vector3d a = r.left * left.ray(uv_left), b = r.right * right.ray(uv_right);
  if (!(a.z() > 0) || !(b.z() > 0)) return std::numeric_limits<double>::quiet_NaN();
  return std::abs(left.fy) * (b.y() / b.z() - a.y() / a.z());
}

}  // namespace iclk
