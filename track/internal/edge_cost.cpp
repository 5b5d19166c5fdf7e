#include <iclk/track/internal/edge_cost.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include <iclk/refine/internal/reprojection.h>

namespace iclk::internal {

EdgeCost::EdgeCost(const BundleEdge& edge) : T_ji_(edge.T_to_from) {
  const Matrix6d information = edge.covariance.inverse();
  W_ = information.llt().matrixL().transpose();
}

bool EdgeCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const SE3 T_i = to_pose(parameters[0]), T_j = to_pose(parameters[1]);
  const Vector6d xi = (T_ji_.inverse() * (T_j.inverse() * T_i)).log();
  Eigen::Map<Vector6d>{residuals} = W_ * xi;
  if (!jacobians) return true;
  const Matrix6d J = W_ * inverse_right_jacobian(xi);
  using Block = Eigen::Matrix<double, 6, 12, Eigen::RowMajor>;
  const PoseManifold manifold;
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

}  // namespace iclk::internal
