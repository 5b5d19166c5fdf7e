#pragma once
#include <Eigen/Core>

namespace iclk {

/// A pinhole camera with its image size. Pixel centres lie at integer coordinates.
///
///   u = fx X / Z + cx,   v = fy Y / Z + cy,   domain Z > 0.
///
/// Negative focal lengths are valid (ICL-NUIM has fy < 0: v decreases with Y).
struct Camera {
  double fx = 0, fy = 0, cx = 0, cy = 0;
  int width = 0, height = 0;  ///< pixels of the image that the intrinsics belong to

  /// Throws Error(invalid_argument) that names the value, for values that are not finite, an empty image, and a focal length
  /// that is zero or too short. Too short means a field of view above 168 degrees; it usually comes from intrinsics in
  /// millimetres or as fractions of the image size.
  void check() const;

  /// The camera of pyramid level l (2x2 means): fx / 2^l, (cx + 0.5) / 2^l - 0.5, and the same for fy and cy; sizes floored.
  Camera at_level(int level) const;

  /// The camera of the image resized to new_width x new_height, where the outer edges of pixels stay the outer edges.
  Camera resized(int new_width, int new_height) const;

  /// The ray through pixel uv: (X / Z, Y / Z, 1).
  Eigen::Vector3d ray(const Eigen::Vector2d& uv) const { return {(uv.x() - cx) / fx, (uv.y() - cy) / fy, 1.0}; }

  /// Precondition: X.z() > 0.
  Eigen::Vector2d project(const Eigen::Vector3d& X) const { return {fx * X.x() / X.z() + cx, fy * X.y() / X.z() + cy}; }

  /// d(u, v) / dX at X. Precondition: X.z() > 0.
  Eigen::Matrix<double, 2, 3> project_jacobian(const Eigen::Vector3d& X) const;

  /// Whether bilinear interpolation at uv has four neighbours: 0 <= u <= width - 1, 0 <= v <= height - 1.
  bool contains(const Eigen::Vector2d& uv) const {
    return uv.x() >= 0 && uv.y() >= 0 && uv.x() <= width - 1 && uv.y() <= height - 1;
  }
};

}  // namespace iclk
