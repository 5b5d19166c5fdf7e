#pragma once
#include <cmath>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>

namespace iclk {

/// Lens distortion. The coefficients do not depend on the image size.
struct Distortion {
  enum class Model { none, radtan, equidistant };
  Model model = Model::none;
  /// radtan: k1, k2, p1, p2[, k3[, k4, k5, k6]], in OpenCV's order; k4, k5, k6 form the denominator. equidistant: k1, k2, k3,
  /// k4.
  std::vector<double> k;

  bool empty() const { return model == Model::none; }
  bool operator==(const Distortion&) const = default;
};

/// The largest angle from the axis that equidistant lenses show, in rad. Near 90 degrees, depth along the axis goes to zero.
inline constexpr double kWidestAngle = 1.5;

/// Maps directions (x, y, 1) through a distortion and back, in double precision. shaders/render/lens.glsl does the same on the
/// device.
///
/// The domain ends where the radial polynomial stops growing, because it would map directions beyond to wrong places inside
/// the image. It ends at a radius of 4 (radtan) or at kWidestAngle (equidistant) at the latest.
class Lens {
 public:
  Lens() = default;  ///< a pinhole
  /// Throws Error(invalid_argument) for a wrong number of coefficients, and for coefficients that are not finite.
  explicit Lens(Distortion distortion);

  const Distortion& distortion() const { return distortion_; }
  bool empty() const { return distortion_.empty(); }

  /// The position on the image plane at focal length 1 of the ray (x, y, 1). Precondition: |xy| < radius().
  Eigen::Vector2d distort(const Eigen::Vector2d& xy) const;
  /// The ray that distort() maps to `distorted`, within 1e-12; nothing outside the domain.
  std::optional<Eigen::Vector2d> undistort(const Eigen::Vector2d& distorted) const;

  double radius() const { return radius_; }  ///< |xy| at the edge of the domain; infinite for a pinhole
  double limit() const { return limit_; }  ///< the argument of the radial polynomial there: a radius, or an angle (equidistant)
  /// The coefficients k of f(r) = r (1 + k[0] r^2 + k[1] r^4 + k[2] r^6 + k[3] r^8) / d(r), for r a radius or an angle.
  const Eigen::Vector4d& radial() const { return radial_; }
  /// The coefficients k of d(r) = 1 + k[0] r^2 + k[1] r^4 + k[2] r^6.
  const Eigen::Vector3d& denominator() const { return denominator_; }
  const Eigen::Vector2d& tangential() const { return tangential_; }  ///< p1, p2

 private:
  double f(double r) const;
  double slope(double r) const;
  double inverse(double seen) const;
  Eigen::Matrix2d jacobian(const Eigen::Vector2d& xy) const;

  Distortion distortion_;
  Eigen::Vector4d radial_ = Eigen::Vector4d::Zero();
  Eigen::Vector3d denominator_ = Eigen::Vector3d::Zero();
  Eigen::Vector2d tangential_ = Eigen::Vector2d::Zero();
  double limit_ = INFINITY, radius_ = INFINITY;
};

/// Undistorts pixel uv: the pixel of the same ray in a pinhole with the same intrinsics. Nothing outside the lens's domain.
std::optional<Eigen::Vector2d> pinhole_pixel(const Camera& camera, const Lens& lens, const Eigen::Vector2d& uv);

}  // namespace iclk
