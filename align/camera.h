#pragma once
#include <Eigen/Core>

namespace iclk {

/// A pinhole camera that knows its image size; pixel centres lie at integer coordinates.
///
///   u = fx X / Z + cx,   v = fy Y / Z + cy,   domain Z > 0.
///
/// A negative focal length is legal (ICL-NUIM has fy < 0: v grows against Y).
struct Camera {
  double fx = 0, fy = 0, cx = 0, cy = 0;
  int width = 0, height = 0;  ///< pixels of the image that the intrinsics belong to

  /// Throws Error(invalid_argument) that names the value: not finite, an empty image, a focal length of zero or so short that
  /// the image would be wider or higher than 168 degrees (intrinsics over the image's sides, or in millimetres).
  void check() const;

  /// The camera of pyramid level l (2x2 means): fx / 2^l, (cx + 0.5) / 2^l - 0.5, sizes floored.
  Camera at_level(int level) const;

  /// The same camera for an image resized to width x height (area convention: the outer edges stay the outer edges).
  Camera resized(int new_width, int new_height) const;

  /// (X / Z, Y / Z) of the ray through pixel uv, the third component 1.
  Eigen::Vector3d ray(const Eigen::Vector2d& uv) const { return {(uv.x() - cx) / fx, (uv.y() - cy) / fy, 1.0}; }

  /// Precondition: X.z() > 0.
  Eigen::Vector2d project(const Eigen::Vector3d& X) const { return {fx * X.x() / X.z() + cx, fy * X.y() / X.z() + cy}; }

  /// d(u, v) / dX at X. Precondition: X.z() > 0.
  Eigen::Matrix<double, 2, 3> project_jacobian(const Eigen::Vector3d& X) const;

  /// 0 <= u <= width - 1 and the same for v: where bilinear interpolation has four neighbours.
  bool contains(const Eigen::Vector2d& uv) const {
    return uv.x() >= 0 && uv.y() >= 0 && uv.x() <= width - 1 && uv.y() <= height - 1;
  }
};

}  // namespace iclk
