#pragma once
#include <ceres/ceres.h>

#include <iclk/align/se3.h>

namespace iclk::internal {

/// A separately estimated motion between two frames: T_to_from = mean Exp(xi), with this covariance of xi = [rho, phi].
struct BundleEdge {
  int from = 0, to = 0;
  SE3 T_to_from;
  Matrix6d covariance = Matrix6d::Identity();
  bool robust = false;  ///< with the Cauchy loss
};

/// W Log(T_ji^-1 T_j^-1 T_i), with T_i = T_WC of `from` and W^T W the information of the edge. Parameters: the pose blocks
/// (PoseBlock) of `from` and `to`.
class EdgeCost final : public ceres::SizedCostFunction<6, 12, 12> {
 public:
  explicit EdgeCost(const BundleEdge& edge);
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

 private:
  SE3 T_ji_;
  Matrix6d W_;
};

}  // namespace iclk::internal
