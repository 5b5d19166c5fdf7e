#pragma once
#include <Eigen/Core>

namespace iclk {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

/// A rigid motion. `T_10` maps a point of camera 0 into camera 1: X_1 = R X_0 + t.
///
/// A twist is xi = [rho, phi]: translation first, then rotation (rad). Exp is the full SE(3) exponential,
///   Exp(xi) = [exp(phi^), V(phi) rho; 0, 1].
struct SE3 {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Vector3d t = Eigen::Vector3d::Zero();

  static SE3 exp(const Vector6d& xi);
  /// The twist xi with `exp(xi) == *this` and |phi| <= pi. Precondition: R is a rotation.
  Vector6d log() const;

  SE3 inverse() const { return {R.transpose(), -(R.transpose() * t)}; }
  SE3 operator*(const SE3& b) const { return {R * b.R, R * b.t + t}; }
  Eigen::Vector3d operator*(const Eigen::Vector3d& X) const { return R * X + t; }
  Eigen::Matrix4d matrix() const;
  /// Throws Error(invalid_argument) unless M is finite, its last row is 0 0 0 1 and its upper left block is a rotation within
  /// 1e-3. The rotation is then made exact.
  static SE3 from_matrix(const Eigen::Matrix4d& M);

  /// The angle of R in radians, in [0, pi].
  double angle() const;
  /// Replaces R by the nearest rotation, to remove the rounding errors of many products.
  void orthonormalize();
};

/// The matrix v^ with v^ x = v cross x.
Eigen::Matrix3d hat(const Eigen::Vector3d& v);

/// The matrix Ad(T) = [R, t^ R; 0, R] for [rho, phi]: T Exp(xi) = Exp(Ad(T) xi) T.
Matrix6d adjoint(const SE3& T);

/// The matrix ad(xi) of se(3) for [rho, phi]: Exp(a) Exp(b) ~ Exp(a + b + 1/2 ad(a) b + ...).
Matrix6d small_adjoint(const Vector6d& xi);

/// The inverse right Jacobian as a series, J_r^-1(xi) = I + ad/2 + ad^2/12, error O(|xi|^4):
/// Log(Exp(xi) Exp(d)) = xi + J_r^-1(xi) d + O(d^2). The shaders use the same series.
Matrix6d inverse_right_jacobian(const Vector6d& xi);

}  // namespace iclk
