#include <iclk/align/se3.h>

#include <cmath>
#include <string>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/SVD>

#include <iclk/engine/error.h>

namespace iclk {

Eigen::Matrix3d hat(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

namespace {

// Coefficients of exp and V: a = sin t / t, b = (1 - cos t) / t^2, c = (t - sin t) / t^3.
struct Coefficients {
  double a, b, c;
};

Coefficients coefficients(double theta2) {
  if (theta2 < 1e-10) return {1 - theta2 / 6, 0.5 - theta2 / 24, 1.0 / 6 - theta2 / 120};
  const double theta = std::sqrt(theta2);
  const double half = std::sin(0.5 * theta);
  return {std::sin(theta) / theta, 2 * half * half / theta2, (theta - std::sin(theta)) / (theta2 * theta)};
}

}  // namespace

SE3 SE3::exp(const Vector6d& xi) {
  const Eigen::Vector3d rho = xi.head<3>(), phi = xi.tail<3>();
  const auto [a, b, c] = coefficients(phi.squaredNorm());
  const Eigen::Matrix3d W = hat(phi), W2 = W * W;
  SE3 T;
  T.R += a * W + b * W2;
  T.t = rho + b * (W * rho) + c * (W2 * rho);
  return T;
}

Vector6d SE3::log() const {
  const Eigen::AngleAxisd aa(Eigen::Quaterniond(R).normalized());  // the quaternion keeps precision near 0 and near pi
  const double angle = aa.angle();
  const Eigen::Vector3d phi = angle * aa.axis();
  const Eigen::Matrix3d W = hat(phi);
  // V^-1 = I - W/2 + (1/theta^2 - (1 + cos) / (2 theta sin)) W^2
  const double theta2 = angle * angle;
  const double k = theta2 < 1e-8 ? 1.0 / 12 + theta2 / 720 : (1 - 0.5 * angle / std::tan(0.5 * angle)) / theta2;
  Vector6d xi;
  xi << t - 0.5 * (W * t) + k * (W * (W * t)), phi;
  return xi;
}

Eigen::Matrix4d SE3::matrix() const {
  Eigen::Matrix4d M = Eigen::Matrix4d::Identity();
  M.topLeftCorner<3, 3>() = R;
  M.topRightCorner<3, 1>() = t;
  return M;
}

SE3 SE3::from_matrix(const Eigen::Matrix4d& M) {
  if (!M.allFinite()) throw Error(ErrorCode::invalid_argument, "pose matrix has an entry that is not finite");
  const Eigen::RowVector4d last(0, 0, 0, 1);
  if ((M.row(3) - last).norm() > 1e-6) throw Error(ErrorCode::invalid_argument, "last row of a pose matrix must be 0 0 0 1");
  SE3 T{M.topLeftCorner<3, 3>(), M.topRightCorner<3, 1>()};
  const double off = (T.R * T.R.transpose() - Eigen::Matrix3d::Identity()).norm();
  if (off > 1e-3 || T.R.determinant() < 0)
    throw Error(ErrorCode::invalid_argument, "upper left block of the pose matrix is not a rotation: |R R^T - I| = " +
                                                 std::to_string(off) + ", det R = " + std::to_string(T.R.determinant()));
  T.orthonormalize();
  return T;
}

double SE3::angle() const {
  const Eigen::Quaterniond q(R);
  return 2 * std::atan2(q.vec().norm(), std::abs(q.w()));
}

void SE3::orthonormalize() {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(R, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d U = svd.matrixU();
  if ((U * svd.matrixV().transpose()).determinant() < 0) U.col(2) *= -1;
  R = U * svd.matrixV().transpose();
}

Matrix6d adjoint(const SE3& T) {
  Matrix6d A = Matrix6d::Zero();
  A.block<3, 3>(0, 0) = A.block<3, 3>(3, 3) = T.R;
  A.block<3, 3>(0, 3) = hat(T.t) * T.R;
  return A;
}

Matrix6d small_adjoint(const Vector6d& xi) {
  const Eigen::Matrix3d P = hat(xi.head<3>()), W = hat(xi.tail<3>());
  Matrix6d m = Matrix6d::Zero();
  m.topLeftCorner<3, 3>() = W;
  m.topRightCorner<3, 3>() = P;
  m.bottomRightCorner<3, 3>() = W;
  return m;
}

Matrix6d inverse_right_jacobian(const Vector6d& xi) {
  const Matrix6d ad = small_adjoint(xi);
  return Matrix6d::Identity() + 0.5 * ad + ad * ad / 12;
}

}  // namespace iclk
