#include <iclk/track/bundle.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include <ceres/ceres.h>
#include <Eigen/Cholesky>
#include <Eigen/LU>

#include <iclk/refine/internal/reprojection.h>

namespace iclk {
namespace {

constexpr double kLeastDepth = 1e-3;  // of a point in the camera that sees it, times its inverse depth

/// W (project(p) - uv), p = R_j^T (R_i ray + q (t_i - t_j)): the point in camera j, times q.
class SightingCost final : public ceres::SizedCostFunction<2, 12, 12, 1> {
 public:
  SightingCost(const Camera& camera, const Eigen::Vector2d& uv0, const Eigen::Vector2d& uv1, const Eigen::Matrix2d& W)
      : camera_(camera), ray_(camera.ray(uv0)), uv1_(uv1), W_(W) {}

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const SE3 T_i = internal::to_pose(parameters[0]), T_j = internal::to_pose(parameters[1]);
    const double q = parameters[2][0];
    const Eigen::Vector3d v = T_i.R * ray_ + q * (T_i.t - T_j.t), p = T_j.R.transpose() * v;
    if (!(p.z() > kLeastDepth)) return false;
    Eigen::Map<Eigen::Vector2d>{residuals} = W_ * (camera_.project(p) - uv1_);
    if (!jacobians) return true;
    const Eigen::Matrix<double, 2, 3> J = W_ * camera_.project_jacobian(p);
    const Eigen::Matrix<double, 2, 3> JR = J * T_j.R.transpose();
    using Block = Eigen::Matrix<double, 2, 12, Eigen::RowMajor>;
    if (jacobians[0]) {  // R_i column by column, then t_i
      Eigen::Map<Block> to(jacobians[0]);
      for (int k = 0; k < 3; ++k) to.block<2, 3>(0, 3 * k) = ray_[k] * JR;
      to.block<2, 3>(0, 9) = q * JR;
    }
    if (jacobians[1]) {  // p_k = R_j.col(k) . v
      Eigen::Map<Block> to(jacobians[1]);
      for (int k = 0; k < 3; ++k) to.block<2, 3>(0, 3 * k) = J.col(k) * v.transpose();
      to.block<2, 3>(0, 9) = -q * JR;
    }
    if (jacobians[2]) Eigen::Map<Eigen::Vector2d>{jacobians[2]} = JR * (T_i.t - T_j.t);
    return true;
  }

 private:
  Camera camera_;
  Eigen::Vector3d ray_;
  Eigen::Vector2d uv1_;
  Eigen::Matrix2d W_;
};

Matrix6d adjoint(const SE3& T) {
  Matrix6d A = Matrix6d::Zero();
  A.block<3, 3>(0, 0) = A.block<3, 3>(3, 3) = T.R;
  A.block<3, 3>(0, 3) = hat(T.t) * T.R;
  return A;
}

/// W Log(T_ji^-1 T_j^-1 T_i), with T_i = T_WC of `from`.
class EdgeCost final : public ceres::SizedCostFunction<6, 12, 12> {
 public:
  explicit EdgeCost(const BundleEdge& edge) : T_ji_(edge.T_to_from) {
    const Matrix6d information = edge.covariance.inverse();
    W_ = information.llt().matrixL().transpose();
  }
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const SE3 T_i = internal::to_pose(parameters[0]), T_j = internal::to_pose(parameters[1]);
    const Vector6d xi = (T_ji_.inverse() * (T_j.inverse() * T_i)).log();
    Eigen::Map<Vector6d>{residuals} = W_ * xi;
    if (!jacobians) return true;
    const Matrix6d J = W_ * inverse_right_jacobian(xi);
    using Block = Eigen::Matrix<double, 6, 12, Eigen::RowMajor>;
    const internal::PoseManifold manifold;
    Block minus;  // maps Ceres's ambient space to the twist
    if (jacobians[0]) {
      manifold.MinusJacobian(parameters[0], minus.data());
      Eigen::Map<Block>{jacobians[0]} = J * minus;
    }
    if (jacobians[1]) {
      manifold.MinusJacobian(parameters[1], minus.data());
      Eigen::Map<Block>{jacobians[1]} = -J * adjoint(T_i.inverse() * T_j) * minus;
    }
    return true;
  }

 private:
  SE3 T_ji_;
  Matrix6d W_;
};

bool seen(const SE3& T_i, const SE3& T_j, const Eigen::Vector3d& ray, double q) {
  return (T_j.R.transpose() * (T_i.R * ray + q * (T_i.t - T_j.t))).z() > 2 * kLeastDepth;
}

}  // namespace

BundleResult adjust(const Camera& camera, std::span<BundleFrame> frames, std::span<const BundleSighting> sightings,
                    std::span<const BundleEdge> edges, const BundleOptions& options) {
  BundleResult result;
  if (frames.empty()) return result;
  std::vector<internal::PoseBlock> poses;
  for (const BundleFrame& frame : frames) poses.push_back(internal::to_block(frame.T_WC));
  // Ceres orders what it eliminates by address: in one piece, so that the same bundle gives the same bits.
  std::vector<double> depths;
  std::vector<size_t> first_depth;
  for (const BundleFrame& frame : frames) {
    first_depth.push_back(depths.size());
    depths.insert(depths.end(), frame.inverse_depth.begin(), frame.inverse_depth.end());
  }

  ceres::Problem problem;
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  bool anchored = false;
  std::vector<bool> posed(frames.size());
  const auto add_pose = [&](size_t i) {
    if (posed[i]) return;
    posed[i] = true;
    problem.AddParameterBlock(poses[i].data(), 12, new internal::PoseManifold);
    ordering->AddElementToGroup(poses[i].data(), 1);
    if (!frames[i].fixed) return;
    problem.SetParameterBlockConstant(poses[i].data());
    anchored = true;
  };
  for (const BundleSighting& s : sightings) {
    const auto i = static_cast<size_t>(s.frame), j = static_cast<size_t>(s.seen_in), k = static_cast<size_t>(s.feature);
    double& q = depths[first_depth[i] + k];
    if (frames[i].fixed && frames[j].fixed) continue;
    if (!(q > 0) || !seen(frames[i].T_WC, frames[j].T_WC, camera.ray(frames[i].uv[k]), q)) continue;
    add_pose(i);
    add_pose(j);
    const bool first = !problem.HasParameterBlock(&q);
    const Eigen::Matrix2d W = internal::whitening(s.covariance, options.floor) / options.floor;
    problem.AddResidualBlock(new SightingCost(camera, frames[i].uv[k], s.uv, W), new ceres::CauchyLoss(options.cauchy_scale),
                             poses[i].data(), poses[j].data(), &q);
    ++result.sightings;
    if (!first) continue;
    ordering->AddElementToGroup(&q, 0);
    if (frames[i].fixed) {
      problem.SetParameterBlockConstant(&q);
      continue;
    }
    problem.SetParameterLowerBound(&q, 0, 1e-3 * q);
    if (frames[i].prior_sigma[k] > 0)
      problem.AddResidualBlock(new internal::DepthPriorCost(frames[i].prior[k], 1 / frames[i].prior_sigma[k]), nullptr, &q);
  }
  for (const BundleEdge& edge : edges) {
    const auto i = static_cast<size_t>(edge.from), j = static_cast<size_t>(edge.to);
    if (frames[i].fixed && frames[j].fixed) continue;
    add_pose(i);
    add_pose(j);
    problem.AddResidualBlock(new EdgeCost(edge), nullptr, poses[i].data(), poses[j].data());
  }
  if (problem.NumResidualBlocks() == 0) return result;
  for (size_t i = 0; !anchored && i < frames.size(); ++i)
    if (posed[i]) {
      problem.SetParameterBlockConstant(poses[i].data());
      anchored = true;
    }
  ceres::Solver::Options solver = internal::solver_options(options.iterations);
  solver.linear_solver_type = ceres::DENSE_SCHUR;
  solver.linear_solver_ordering = ordering;
  solver.function_tolerance = 1e-4;
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);
  result.initial_cost = summary.initial_cost;
  result.cost = summary.final_cost;
  result.iterations = summary.num_successful_steps + summary.num_unsuccessful_steps;
  result.usable = summary.IsSolutionUsable();
  if (!result.usable) return result;
  for (size_t i = 0; i < frames.size(); ++i) {
    if (frames[i].fixed) continue;
    frames[i].T_WC = internal::to_pose(poses[i].data());
    frames[i].T_WC.orthonormalize();
    std::copy_n(depths.begin() + static_cast<std::ptrdiff_t>(first_depth[i]), frames[i].inverse_depth.size(),
                frames[i].inverse_depth.begin());
  }
  return result;
}

}  // namespace iclk
