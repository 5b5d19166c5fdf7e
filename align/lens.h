#pragma once
#include <cmath>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>

namespace iclk {

/// How a lens departs from the pinhole. Coefficients do not depend on the image size.
struct Distortion {
  enum class Model { none, radtan, equidistant };
  Model model = Model::none;
  /// radtan: k1, k2, p1, p2[, k3[, k4, k5, k6]], eight of them with OpenCV's denominator; equidistant: k1, k2, k3, k4.
  std::vector<double> k;

  bool empty() const { return model == Model::none; }
  bool operator==(const Distortion&) const = default;
};

/// rad from the axis: an equidistant lens shows nothing beyond, where depth along the axis comes to its end.
inline constexpr double kWidestAngle = 1.5;

/// A distortion as a map of directions (x, y, 1), in both ways, in double precision. shaders/render/lens.glsl is its twin.
///
/// Its domain ends where the radial polynomial stops to grow: beyond, the model folds back into the image and would show what
/// the lens never saw there. radtan ends at a radius of 4 at the latest, equidistant at kWidestAngle.
class Lens {
 public:
  Lens() = default;  ///< a pinhole
  /// Throws Error(invalid_argument) for another number of coefficients than the model has, and for some that are not finite.
  explicit Lens(Distortion distortion);

  const Distortion& distortion() const { return distortion_; }
  bool empty() const { return distortion_.empty(); }

  /// Of a ray's (x, y): where on the image plane at focal length 1 it is seen. Precondition: |xy| < radius().
  Eigen::Vector2d distort(const Eigen::Vector2d& xy) const;
  /// The ray that is seen there, so exactly that distort() comes back within 1e-12; nothing outside the domain.
  std::optional<Eigen::Vector2d> undistort(const Eigen::Vector2d& distorted) const;

  double radius() const { return radius_; }  ///< |xy| of the domain's edge; infinite for a pinhole
  double limit() const { return limit_; }    ///< the same as the polynomial has it: equidistant, an angle
  /// f(r) = r (1 + k[0] r^2 + k[1] r^4 + k[2] r^6 + k[3] r^8), of a radius or an angle; over denominator(), which is
  /// 1 + k[0] r^2 + k[1] r^4 + k[2] r^6.
  const Eigen::Vector4d& radial() const { return radial_; }
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

/// Where the pinhole of the same camera sees what pixel uv sees through the lens; nothing outside the lens's domain.
std::optional<Eigen::Vector2d> pinhole_pixel(const Camera& camera, const Lens& lens, const Eigen::Vector2d& uv);

}  // namespace iclk
