#pragma once
#include <cmath>
#include <vector>

#include <iclk/align/camera.h>
#include <iclk/align/pyramid.h>
#include <iclk/align/se3.h>

namespace iclk::internal {

/// One mask pixel of a level, with all data of image 0 that the iterations need. inverse_depth 0: outside the mask.
/// Sparse mode: element feature * 64 + patch pixel. Dense mode: element v * width + u.
struct TemplatePixel {
  float u = 0, v = 0;  ///< pixel of this level
  float inverse_depth = 0;
  float f0 = 0;
  float gu = 0, gv = 0;  ///< central differences of f0
};

using Template = std::vector<TemplatePixel>;

/// The position in image 1 of pixel (u, v) of image 0 with inverse depth q, at the same level.
struct Warped {
  double u = 0, v = 0;
  bool visible = false;  ///< in front of the camera and inside the image
};

inline Warped warp(const Camera& level_camera, const SE3& T_10, double u, double v, double q) {
  const Eigen::Vector3d ray((u - level_camera.cx) / level_camera.fx, (v - level_camera.cy) / level_camera.fy, 1.0);
  // The motion of the point, divided by its depth in camera 0. Without motion (u, v) stays exactly the same, so rounding does
  // not decide which border pixels are visible.
  const Eigen::Vector3d moved = (T_10.R - Eigen::Matrix3d::Identity()) * ray + q * T_10.t, p = ray + moved;
  Warped w;
  if (!(p.z() > 1e-6)) return w;
  w.u = u + (moved.x() - moved.z() * ray.x()) * level_camera.fx / p.z();
  w.v = v + (moved.y() - moved.z() * ray.y()) * level_camera.fy / p.z();
  w.visible = w.u >= 0 && w.v >= 0 && w.u <= level_camera.width - 1 && w.v <= level_camera.height - 1;
  return w;
}

/// The same with the map of image 1, whose hidden pixels are not visible.
inline Warped warp(const Camera& level_camera, const SE3& T_10, const TemplatePixel& p, const Map& f1) {
  Warped w = warp(level_camera, T_10, p.u, p.v, p.inverse_depth);
  w.visible = w.visible && !f1.hidden(w.u, w.v);
  return w;
}

}  // namespace iclk::internal
