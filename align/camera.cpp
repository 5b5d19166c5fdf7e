#include <iclk/align/camera.h>

#include <cmath>
#include <sstream>

#include <iclk/engine/error.h>

namespace iclk {
namespace {

constexpr double kLeastFocal = 0.05;  // of the image's side

}  // namespace

void Camera::check() const {
  std::ostringstream why;
  if (!std::isfinite(fx) || !std::isfinite(fy) || !std::isfinite(cx) || !std::isfinite(cy))
    why << "camera fx,fy,cx,cy = " << fx << "," << fy << "," << cx << "," << cy << " is not finite";
  else if (fx == 0 || fy == 0)
    why << "camera focal length fx,fy = " << fx << "," << fy << " must not be zero";
  else if (width <= 0 || height <= 0)
    why << "camera image size " << width << "x" << height << " is empty";
  else if (std::abs(fx) < kLeastFocal * width || std::abs(fy) < kLeastFocal * height)
    why << "camera focal length fx,fy = " << fx << "," << fy << " is too short for " << width << "x" << height
        << " pixels; give it in pixels (multiply normalised fx and cx by the width, fy and cy by the height)";
  else
    return;
  throw Error(ErrorCode::invalid_argument, why.str());
}

Camera Camera::at_level(int level) const {
  const double s = std::ldexp(1.0, level);
  return {fx / s, fy / s, (cx + 0.5) / s - 0.5, (cy + 0.5) / s - 0.5, width >> level, height >> level};
}

Camera Camera::resized(int new_width, int new_height) const {
  const double sx = static_cast<double>(new_width) / width, sy = static_cast<double>(new_height) / height;
  return {fx * sx, fy * sy, (cx + 0.5) * sx - 0.5, (cy + 0.5) * sy - 0.5, new_width, new_height};
}

Eigen::Matrix<double, 2, 3> Camera::project_jacobian(const Eigen::Vector3d& X) const {
  const double iz = 1 / X.z();
  Eigen::Matrix<double, 2, 3> J;
  J << fx * iz, 0, -fx * X.x() * iz * iz, 0, fy * iz, -fy * X.y() * iz * iz;
  return J;
}

}  // namespace iclk
