#pragma once
#include <optional>

#include <opencv2/calib3d.hpp>

#include "apps/iclk/io/stereo_file.h"
#include "apps/iclk/io/undistorter.h"

namespace iclk {

/// Depth of a rig's left image by OpenCV's semi-global matching of the rectified pair.
class StereoDepth {
 public:
  /// `width`, `height`: of the images. Throws Error(invalid_argument) for a rig whose cameras do not see the same.
  StereoDepth(const StereoFile& rig, int width, int height);

  const Camera& camera() const { return camera_; }         ///< of the rectified left image
  const SE3& T_left_rectified() const { return T_left_; }  ///< a rotation: camera() to the rig's left camera
  double baseline() const { return baseline_; }            ///< m

  const Undistorter& left() const { return *left_; }  ///< makes the rectified image of the left one
  /// CV_32FC1 metres of the rectified left image, 0 where there is none. `right` as it was taken.
  cv::Mat depth(const cv::Mat& rectified_left, const cv::Mat& right) const;

 private:
  Camera camera_;
  SE3 T_left_;
  double baseline_ = 0;
  std::optional<Undistorter> left_, right_;
  cv::Ptr<cv::StereoSGBM> matcher_;
};

}  // namespace iclk
