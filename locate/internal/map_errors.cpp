#include <iclk/locate/internal/map_errors.h>

#include <algorithm>

#include <Eigen/Cholesky>
#include <Eigen/LU>

namespace iclk::internal {
namespace {

constexpr double kIndependent = 16;  // errors in a picture
constexpr double kShift = 0.3;       // texels: standard deviation of an error that all points share, along x and y
constexpr double kHeight = 0.1;      // steps of the heights: the same along z, and of each height

using Matrix26 = Eigen::Matrix<double, 2, 6>;

}  // namespace

Matrix6d map_covariance(const Camera& camera, std::span<const Eigen::Vector3d> points, const Eigen::Matrix3d& R_WC,
                        const MapErrors& errors) {
  const double height = kHeight * errors.height, shift = kShift * errors.texel;
  Matrix6d H = Matrix6d::Zero();
  for (const Eigen::Vector3d& X : points) {
    const Eigen::Matrix<double, 2, 3> project = camera.project_jacobian(X);
    Matrix26 J;  // the point is seen at Exp(-xi) X
    J << -project, project * hat(X);
    const Eigen::Vector2d raised = height * project * R_WC.row(2).transpose();
    const Eigen::Matrix2d covariance = errors.sigma * errors.sigma * Eigen::Matrix2d::Identity() + raised * raised.transpose();
    H += J.transpose() * covariance.inverse() * J;
  }
  const Eigen::LDLT<Matrix6d> factor(H);
  if (points.size() < 3 || factor.vectorD().minCoeff() <= 1e-10 * factor.vectorD().maxCoeff()) return Matrix6d::Zero();
  const double n = static_cast<double>(points.size());
  Matrix6d covariance = std::max(1.0, n / kIndependent) * factor.solve(Matrix6d::Identity());
  const Eigen::Vector3d shared(shift * shift, shift * shift, height * height);
  covariance.topLeftCorner<3, 3>() += R_WC.transpose() * shared.asDiagonal() * R_WC;
  return 0.5 * (covariance + covariance.transpose());
}

}  // namespace iclk::internal
