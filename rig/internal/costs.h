#pragma once
// The costs of adjust_rig() and smooth_flex(). Poses are PoseBlocks (refine/internal/reprojection.h).
#include <ceres/ceres.h>
#include <Eigen/Cholesky>
#include <Eigen/LU>

#include <iclk/align/se3.h>
#include <iclk/refine/internal/reprojection.h>
#include <iclk/rig/internal/chain.h>

namespace iclk::internal {

inline constexpr double kLeastDepth = 1e-3;  // of a point in the right camera, times its inverse depth

/// The residual (|t| - length) / sigma.
class BaselineCost final : public ceres::SizedCostFunction<1, 12> {
 public:
  BaselineCost(double length, double sigma) : length_(length), weight_(1 / sigma) {}
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const Eigen::Map<const Eigen::Vector3d> t(parameters[0] + 9);
    const double norm = t.norm();
    if (!(norm > 0)) return false;
    residuals[0] = weight_ * (norm - length_);
    if (jacobians && jacobians[0]) {
      Eigen::Map<Eigen::Matrix<double, 1, 12>> to(jacobians[0]);
      to.setZero();
      to.tail<3>() = weight_ / norm * t.transpose();
    }
    return true;
  }

 private:
  double length_, weight_;
};

using State = Eigen::Matrix<double, 12, 1>;  // xi, velocity

/// The residual W Log(T_measured^-1 mean Exp(xi)).
class MeasurementCost final : public ceres::SizedCostFunction<6, 12> {
 public:
  MeasurementCost(const SE3& T_measured, const Matrix6d& covariance, const SE3& mean) : T_(T_measured.inverse() * mean) {
    const Matrix6d information = covariance.inverse();
    W_ = information.llt().matrixU();
  }
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const Vector6d xi = Eigen::Map<const Vector6d>(parameters[0]);
    const Vector6d e = (T_ * SE3::exp(xi)).log();
    Eigen::Map<Vector6d>{residuals} = W_ * e;
    if (!jacobians || !jacobians[0]) return true;
    Eigen::Map<Eigen::Matrix<double, 6, 12, Eigen::RowMajor>> to(jacobians[0]);
    to.setZero();
    to.leftCols<6>() = W_ * inverse_right_jacobian(e) * inverse_right_jacobian(xi).inverse();
    return true;
  }

 private:
  SE3 T_;
  Matrix6d W_;
};

/// The residual W [xi_1 - xi_0 - dt v_0; v_1 - v_0]; its covariance is that of white acceleration over dt.
class MotionCost final : public ceres::SizedCostFunction<12, 12, 12> {
 public:
  MotionCost(double dt, const Vector6d& density) {
    F_.setIdentity();
    F_.topRightCorner<6, 6>().diagonal().setConstant(dt);
    for (int k = 0; k < 6; ++k) {
      Eigen::Matrix2d Q;
      Q << dt * dt * dt / 3, dt * dt / 2, dt * dt / 2, dt;
      const Eigen::Matrix2d information = (Q * density[k]).inverse(), U = information.llt().matrixU();
      W_(k, k) = U(0, 0), W_(k, k + 6) = U(0, 1), W_(k + 6, k + 6) = U(1, 1);
    }
  }
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    Eigen::Map<State>{residuals} = W_ * (Eigen::Map<const State>(parameters[1]) - F_ * Eigen::Map<const State>(parameters[0]));
    using Block = Eigen::Matrix<double, 12, 12, Eigen::RowMajor>;
    if (jacobians && jacobians[0]) Eigen::Map<Block>{jacobians[0]} = -W_ * F_;
    if (jacobians && jacobians[1]) Eigen::Map<Block>{jacobians[1]} = W_;
    return true;
  }

 private:
  Matrix12d F_, W_ = Matrix12d::Zero();
};

/// The prior of a state at zero, with the standard deviations of position and velocity.
class BoundCost final : public ceres::SizedCostFunction<12, 12> {
 public:
  explicit BoundCost(const State& sigma) : weight_(sigma.cwiseInverse()) {}
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    Eigen::Map<State>{residuals} = weight_.cwiseProduct(Eigen::Map<const State>(parameters[0]));
    if (jacobians && jacobians[0])
      Eigen::Map<Eigen::Matrix<double, 12, 12, Eigen::RowMajor>>{jacobians[0]} = weight_.asDiagonal().toDenseMatrix();
    return true;
  }

 private:
  State weight_;
};

}  // namespace iclk::internal
