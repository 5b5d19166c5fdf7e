#pragma once
#include <optional>

#include <Eigen/Core>

#include <iclk/locate/locator.h>

namespace iclk {

/// The place on the ground that a pixel shows.
struct GroundPoint {
  Eigen::Vector3d X = Eigen::Vector3d::Zero();           ///< on the map, m
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();  ///< of X, m^2, from the errors of the pose and of the map's heights
};

/// The ground that a pixel of a located picture shows. The ground is the plane through the depths next to the pixel; at an
/// edge, such as that of a roof, the plane on the side of the nearest pixel.
///
/// `view`: the map from `located.T_WC` with `camera`. `pixel`: of the undistorted picture. `elevation_sigma`: standard
/// deviation of the map's heights, m. Nothing if the picture was not located, and where the view shows no ground.
std::optional<GroundPoint> ground_point(const View& view, const Camera& camera, const Located& located,
                                        const Eigen::Vector2d& pixel, double elevation_sigma);

/// The horizontal standard deviations of a point.
struct ErrorEllipse {
  double major = 0, minor = 0;  ///< m
  double azimuth = 0;           ///< rad, of the major axis, clockwise from north; 0 to pi
};
ErrorEllipse error_ellipse(const Eigen::Matrix3d& covariance);

}  // namespace iclk
