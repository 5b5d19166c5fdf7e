#pragma once
#include <Eigen/Core>
#include <opencv2/core.hpp>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/align/lens.h>

namespace iclk {

/// K of OpenCV, CV_64FC1.
cv::Mat camera_matrix(const Camera& camera);

/// Turns what a distorted camera saw into what the pinhole of the same K would have seen.
class Undistorter {
 public:
  /// Precondition: camera.check() passes.
  Undistorter(const Camera& camera, const Distortion& distortion);
  /// As another pinhole at the same place, `as`, would have seen it, whose axes are turned: R takes directions of the camera
  /// into them.
  Undistorter(const Camera& camera, const Distortion& distortion, const Camera& as,
              const Eigen::Matrix3d& R = Eigen::Matrix3d::Identity());

  cv::Mat image(const cv::Mat& image) const;  ///< bilinear; beyond the source the nearest border pixel is repeated
  cv::Mat depth(const cv::Mat& depth) const;  ///< CV_32FC1 along the axis, old and new; nearest; 0 beyond the source
  Eigen::Vector2d point(const Eigen::Vector2d& uv) const;
  Features features(Features features) const;  ///< point() of each, and its depth along the new axis
  /// Where the camera's image has what the undistorted one has at uv; beyond the lens's domain, its edge.
  Eigen::Vector2d source(const Eigen::Vector2d& uv) const;
  /// CV_8UC1, 255 where the undistorted pixel was really seen. Empty where nothing is remapped.
  const cv::Mat& seen() const { return seen_; }

 private:
  Camera camera_, as_;
  Eigen::Matrix3d R_;
  Distortion distortion_;
  Lens lens_;
  bool identity_ = true;
  cv::Mat map_u_, map_v_, seen_;
};

/// Distances from the camera's centre, of undistorted pixels, become depths along its axis. An empty image stays empty.
void along_axis(const Camera& camera, cv::Mat& depth);
void along_axis(const Camera& camera, Features& features);

}  // namespace iclk
