#include <iclk/locate/ground.h>

#include <algorithm>
#include <cmath>

#include <Eigen/Eigenvalues>

namespace iclk {
namespace {

/// 1 / depth of a view. Along a plane it is a linear function of the pixel.
class InverseDepth {
 public:
  explicit InverseDepth(const View& view) : view_(view) {}

  /// Nothing outside the view and where it shows no ground.
  std::optional<double> at(int u, int v) const {
    if (u < 0 || v < 0 || u >= view_.width || v >= view_.height) return std::nullopt;
    const float z = view_.depth[static_cast<size_t>(v) * static_cast<size_t>(view_.width) + static_cast<size_t>(u)];
    return z > 0 ? std::optional(1.0 / z) : std::nullopt;
  }

  /// The slope at (u, v) in a direction, per pixel: the smaller of the two to the neighbours, because the other may cross an
  /// edge.
  std::optional<double> slope(int u, int v, int du, int dv) const {
    const auto here = at(u, v), ahead = at(u + du, v + dv), behind = at(u - du, v - dv);
    if (!here || (!ahead && !behind)) return std::nullopt;
    const double forward = ahead ? *ahead - *here : *here - *behind, backward = behind ? *here - *behind : forward;
    return std::abs(forward) < std::abs(backward) ? forward : backward;
  }

 private:
  const View& view_;
};

}  // namespace

std::optional<GroundPoint> ground_point(const View& view, const Camera& camera, const Located& located,
                                        const Eigen::Vector2d& pixel, double elevation_sigma) {
  if (!located.converged() || !camera.contains(pixel)) return std::nullopt;
  const auto u = static_cast<int>(std::lround(pixel.x())), v = static_cast<int>(std::lround(pixel.y()));
  const InverseDepth inverse(view);
  const auto here = inverse.at(u, v), along_u = inverse.slope(u, v, 1, 0), along_v = inverse.slope(u, v, 0, 1);
  if (!here || !along_u || !along_v) return std::nullopt;
  // The plane n X = 1 of the camera: n ray = 1 / depth.
  const Eigen::Vector3d centre = camera.ray({u, v}), ray = camera.ray(pixel);
  Eigen::Vector3d n(*along_u * camera.fx, *along_v * camera.fy, 0);
  n.z() = *here - n.dot(centre);
  if (!(n.dot(ray) > 0)) return std::nullopt;
  const double depth = 1 / n.dot(ray);
  const Eigen::Matrix3d& R = located.T_WC.R;
  const Eigen::Vector3d d = R * ray, N = R * n;
  GroundPoint point;
  point.X = located.T_WC.t + depth * d;
  // T Exp([rho, phi]) moves the ray; it meets the same plane, N X = const, elsewhere. A higher plane moves X along the ray.
  const Eigen::Matrix3d onto_plane = Eigen::Matrix3d::Identity() - d * N.transpose() / N.dot(d);
  Eigen::Matrix<double, 3, 6> J;
  J << onto_plane * R, -depth * onto_plane * R * hat(ray);
  const Eigen::Vector3d lifted = d * (N.z() / N.dot(d) * elevation_sigma);
  point.covariance = J * located.covariance * J.transpose() + lifted * lifted.transpose();
  return point;
}

ErrorEllipse error_ellipse(const Eigen::Matrix3d& covariance) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> axes(covariance.topLeftCorner<2, 2>());
  const Eigen::Vector2d sigmas = axes.eigenvalues().cwiseMax(0).cwiseSqrt(), major = axes.eigenvectors().col(1);
  const double azimuth = std::atan2(major.x(), major.y());
  return {sigmas[1], sigmas[0], azimuth < 0 ? azimuth + M_PI : azimuth};
}

}  // namespace iclk
