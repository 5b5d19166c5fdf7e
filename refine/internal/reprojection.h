#pragma once
#include <cmath>
#include <optional>
#include <span>
#include <vector>

#include <ceres/ceres.h>
#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/refine/pose.h>

namespace iclk::internal {

/// T_10 as a parameter block of Ceres: R column by column, then t.
using PoseBlock = Eigen::Matrix<double, 12, 1>;
PoseBlock to_block(const SE3& T);
SE3 to_pose(const double* block);

/// The manifold T_10 Exp(xi): the tangent space of Ceres is the twist [rho, phi].
class PoseManifold final : public ceres::Manifold {
 public:
  int AmbientSize() const override { return 12; }
  int TangentSize() const override { return 6; }
  bool Plus(const double* x, const double* xi, double* x_plus_xi) const override;
  bool PlusJacobian(const double* x, double* jacobian) const override;
  bool Minus(const double* y, const double* x, double* y_minus_x) const override;
  bool MinusJacobian(const double* x, double* jacobian) const override;
};

inline constexpr double kMinDepth = 1e-6;  // of X1 times q, as in the residual of Aligner

/// The residual W (project_1(R ray + q t) - uv1). It is linear in the pose block before the projection, and finite for points
/// at any distance.
class ReprojectionCost final : public ceres::SizedCostFunction<2, 12, 1> {
 public:
  /// `ray`: of camera 0, at depth 1. Points less than `least_depth` / q in front of camera 1 have no residual.
  ReprojectionCost(const Camera& camera_1, const Eigen::Vector3d& ray, const Eigen::Vector2d& uv1, const Eigen::Matrix2d& W,
                   double least_depth = kMinDepth)
      : camera_(camera_1), ray_(ray), uv1_(uv1), W_(W), least_depth_(least_depth) {}
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

 private:
  Camera camera_;
  Eigen::Vector3d ray_;
  Eigen::Vector2d uv1_;
  Eigen::Matrix2d W_;
  double least_depth_;
};

/// The residual weight (q - q0).
class DepthPriorCost final : public ceres::SizedCostFunction<1, 1> {
 public:
  DepthPriorCost(double q0, double weight) : q0_(q0), weight_(weight) {}
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    residuals[0] = weight_ * (parameters[0][0] - q0_);
    if (jacobians != nullptr && jacobians[0] != nullptr) jacobians[0][0] = weight_;
    return true;
  }

 private:
  double q0_, weight_;
};

/// The symmetric matrix sigma_0 (covariance + sigma_0^2 I)^-1/2.
Eigen::Matrix2d whitening(const Eigen::Matrix2d& covariance, double sigma_0);

/// The mean inverse depth of the features, or 1 if none has one. Lengths are multiplied by it, so that tolerances and
/// conditioning are the same for scenes in millimetres and in kilometres.
double unit_of(const Features& features);
Features in_unit(const Features& features, double unit);
SE3 in_unit(const SE3& T_10, double unit);
void from_unit(double unit, PoseResult& result);

/// A feature that is used.
struct Observation {
  int feature = 0;
  Eigen::Vector2d uv0, uv1;
  double q = 0;
  double depth_sigma = 0;  ///< relative, of q; 0: unknown
  Eigen::Matrix2d covariance, W;
};

/// The residual in px, not whitened; nothing if the point is behind the camera.
std::optional<Eigen::Vector2d> residual(const Camera& camera, const Observation& o, const SE3& T_10);

/// The aligned features in front of camera 1, whitened without depth errors. Throws Error(invalid_argument) for vectors of
/// different lengths and a pose that is not finite.
std::vector<Observation> observations(const Camera& camera, const Features& features, std::span<const AlignedFeature> aligned,
                                      const SE3& T_10, double sigma_0);
/// Norms of the whitened residuals of the observations at T_10; infinite for points behind the camera.
std::vector<double> residual_norms(const Camera& camera, std::span<const Observation> observations, const SE3& T_10);

/// A sum of logarithms, with one logarithm for many factors. It is as exact as their product: for small residuals use log1p.
class LogSum {
 public:
  void add(double factor) {
    product_ *= factor;
    if (product_ > 1e-50 && product_ < 1e50) return;
    sum_ += std::log(product_);
    product_ = 1;
  }
  double value() const { return sum_ + std::log(product_); }
  double least() const { return sum_; }  ///< of factors that are at least 1, value() is not less

 private:
  double sum_ = 0, product_ = 1;
};

/// The mean of rho(r^2) / 2 of the Cauchy loss. `scale`: px.
double cauchy_cost(std::span<const double> norms, double scale);

/// The factor of the M-estimator's covariance, for residuals that are not all from one Gaussian: with psi(r) = w r,
///
///   covariance = factor (J^T W J)^-1,   factor = [sum |psi|^2 / (2 n - p)] mean(w) / mean(w^2)^2
///
/// (Huber 1981, 7.6; the mean of psi' of the Cauchy loss in two dimensions is the mean of w^2). It is at least the variance
/// that follows from the median of |r|. If residuals are wider than the loss, the estimate finds a mode, and the covariance of
/// the formula is much too small. Example: with residuals of 1 px, a loss of 0.3 px and 50 features, the normalised error is
/// 4.6 without this bound and 0.5 with it.
double variance_factor(std::span<const double> norms, double scale, int parameters);

ceres::Solver::Options solver_options(int iterations);

/// The outcome of a solver.
struct Ending {
  bool usable = false, converged = false;
  int iterations = 0;
  std::string message;  ///< if not usable
};
Ending ending(const ceres::Solver::Summary& summary);

/// Sets used, inliers, cost and status from the residuals at the final pose. Returns whether the pose gets a covariance.
/// `scale`: of the Cauchy loss, px.
bool judge(std::span<const Observation> observations, const Camera& camera, const Ending& ending, const PoseOptions& options,
           double scale, PoseResult& result);

}  // namespace iclk::internal
