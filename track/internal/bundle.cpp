#include <iclk/track/internal/bundle.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include <ceres/ceres.h>
#include <Eigen/Cholesky>
#include <Eigen/LU>

#include <iclk/refine/internal/reprojection.h>
#include <iclk/track/internal/edge_cost.h>

namespace iclk::internal {
namespace {

constexpr double kCauchyScale = 2;    // a residual of this many standard deviations has half the weight
constexpr double kEdgeScale = 5;      // the same for an edge, whose residual has six components
constexpr double kLeastDepth = 1e-3;  // of a point in the observing camera, times its inverse depth

/// W (project(p) - uv), p = R_j^T (R_i ray + q (t_i - t_j)): the point in camera j, times q.
class SightingCost final : public ceres::SizedCostFunction<2, 12, 12, 1> {
 public:
  SightingCost(const Camera& camera, const Eigen::Vector2d& uv0, const Eigen::Vector2d& uv1, const Eigen::Matrix2d& W)
      : camera_(camera), ray_(camera.ray(uv0)), uv1_(uv1), W_(W) {}

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const SE3 T_i = to_pose(parameters[0]), T_j = to_pose(parameters[1]);
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

bool seen(const SE3& T_i, const SE3& T_j, const Eigen::Vector3d& ray, double q) {
  return (T_j.R.transpose() * (T_i.R * ray + q * (T_i.t - T_j.t))).z() > 2 * kLeastDepth;
}

/// A bundle as a problem of Ceres.
class Bundle {
 public:
  Bundle(const Camera& camera, std::span<const BundleFrame> frames, double floor)
      : camera_(camera), frames_(frames), floor_(floor), posed_(frames.size()) {
    for (const BundleFrame& frame : frames) {
      poses_.push_back(to_block(frame.T_WC));
      first_depth_.push_back(depths_.size());
      depths_.insert(depths_.end(), frame.inverse_depth.begin(), frame.inverse_depth.end());
    }
  }

  /// Adds a sighting. Returns whether it is usable.
  bool add(const BundleSighting& s) {
    const auto i = static_cast<size_t>(s.frame), j = static_cast<size_t>(s.seen_in), k = static_cast<size_t>(s.feature);
    const BundleFrame& frame = frames_[i];
    double& q = depths_[first_depth_[i] + k];
    if (frame.fixed && frames_[j].fixed) return false;
    if (!(q > 0) || !seen(frame.T_WC, frames_[j].T_WC, camera_.ray(frame.uv[k]), q)) return false;
    add_pose(i);
    add_pose(j);
    const bool first = !problem_.HasParameterBlock(&q);
    const Eigen::Matrix2d W = whitening(s.covariance, floor_) / floor_;
    problem_.AddResidualBlock(new SightingCost(camera_, frame.uv[k], s.uv, W), new ceres::CauchyLoss(kCauchyScale),
                              poses_[i].data(), poses_[j].data(), &q);
    if (first) add_depth(frame, k, q);
    return true;
  }

  void add(const BundleEdge& edge) {
    const auto i = static_cast<size_t>(edge.from), j = static_cast<size_t>(edge.to);
    if (frames_[i].fixed && frames_[j].fixed) return;
    add_pose(i);
    add_pose(j);
    problem_.AddResidualBlock(new EdgeCost(edge), edge.robust ? new ceres::CauchyLoss(kEdgeScale) : nullptr, poses_[i].data(),
                              poses_[j].data());
  }

  ceres::Solver::Summary solve(int iterations) {
    ceres::Solver::Summary summary;
    if (problem_.NumResidualBlocks() == 0) return summary;
    const auto first = std::find(posed_.begin(), posed_.end(), true);
    if (!anchored_) problem_.SetParameterBlockConstant(poses_[static_cast<size_t>(first - posed_.begin())].data());
    ceres::Solver::Options solver = solver_options(iterations);
    solver.linear_solver_type = depths_.empty() ? ceres::SPARSE_NORMAL_CHOLESKY : ceres::DENSE_SCHUR;
    solver.linear_solver_ordering = ordering_;
    solver.function_tolerance = 1e-4;
    ceres::Solve(solver, &problem_, &summary);
    return summary;
  }

  /// Copies the results to the frames that are not fixed.
  void read(std::span<BundleFrame> frames) const {
    for (size_t i = 0; i < frames.size(); ++i) {
      if (frames[i].fixed) continue;
      frames[i].T_WC = to_pose(poses_[i].data());
      frames[i].T_WC.orthonormalize();
      std::copy_n(depths_.begin() + static_cast<std::ptrdiff_t>(first_depth_[i]), frames[i].inverse_depth.size(),
                  frames[i].inverse_depth.begin());
    }
  }

 private:
  void add_pose(size_t i) {
    if (posed_[i]) return;
    posed_[i] = true;
    problem_.AddParameterBlock(poses_[i].data(), 12, new PoseManifold);
    ordering_->AddElementToGroup(poses_[i].data(), 1);
    if (!frames_[i].fixed) return;
    problem_.SetParameterBlockConstant(poses_[i].data());
    anchored_ = true;
  }

  void add_depth(const BundleFrame& frame, size_t k, double& q) {
    ordering_->AddElementToGroup(&q, 0);
    if (frame.fixed) {
      problem_.SetParameterBlockConstant(&q);
      return;
    }
    problem_.SetParameterLowerBound(&q, 0, 1e-3 * q);
    if (frame.prior_sigma[k] > 0)
      problem_.AddResidualBlock(new DepthPriorCost(frame.prior[k], 1 / frame.prior_sigma[k]), nullptr, &q);
  }

  const Camera& camera_;
  std::span<const BundleFrame> frames_;
  double floor_;
  std::vector<PoseBlock> poses_;
  // Ceres orders eliminated parameters by address. They are in one array, so that equal bundles give bit-identical results.
  std::vector<double> depths_;
  std::vector<size_t> first_depth_;
  ceres::Problem problem_;
  std::shared_ptr<ceres::ParameterBlockOrdering> ordering_ = std::make_shared<ceres::ParameterBlockOrdering>();
  bool anchored_ = false;
  std::vector<bool> posed_;  // frames whose pose is in the problem
};

}  // namespace

BundleResult adjust(const Camera& camera, std::span<BundleFrame> frames, std::span<const BundleSighting> sightings,
                    std::span<const BundleEdge> edges, const BundleOptions& options) {
  Bundle bundle(camera, frames, options.floor);
  BundleResult result;
  for (const BundleSighting& s : sightings) result.sightings += bundle.add(s);
  for (const BundleEdge& edge : edges) bundle.add(edge);
  const ceres::Solver::Summary summary = bundle.solve(options.iterations);
  result.initial_cost = summary.initial_cost;
  result.cost = summary.final_cost;
  result.usable = summary.IsSolutionUsable();
  if (result.usable) bundle.read(frames);
  return result;
}

}  // namespace iclk::internal
