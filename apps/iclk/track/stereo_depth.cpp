#include "apps/iclk/track/stereo_depth.h"

#include <cmath>

#include <fmt/format.h>
#include <opencv2/core/eigen.hpp>

#include <iclk/engine/error.h>

#include "apps/iclk/session/pair_input.h"

namespace iclk {
namespace {

constexpr int kBlock = 7;         // px
constexpr int kShareOfWidth = 6;  // disparities reach to a sixth of the image's width

}  // namespace

StereoDepth::StereoDepth(const StereoFile& rig, int width, int height) {
  const cv::Size size(width, height);
  const Camera left = fit_camera(rig.left, width, height), right = fit_camera(rig.right, width, height);
  cv::Mat R, t, R0, R1, P0, P1, Q;
  cv::eigen2cv(rig.T_rl.R, R);
  cv::eigen2cv(Eigen::Vector3d(rig.T_rl.t), t);
  // Lenses are undone by the Undistorters.
  cv::stereoRectify(camera_matrix(left), cv::noArray(), camera_matrix(right), cv::noArray(), size, R, t, R0, R1, P0, P1, Q,
                    cv::CALIB_ZERO_DISPARITY, 0, size);
  baseline_ = -P1.at<double>(0, 3) / P1.at<double>(0, 0);
  if (!(baseline_ > 0) || !std::isfinite(baseline_))
    throw Error(ErrorCode::invalid_argument,
                fmt::format("the right camera of the rig is not to the right of the left one: T_rl is [{:.4g} {:.4g} {:.4g}]",
                            rig.T_rl.t.x(), rig.T_rl.t.y(), rig.T_rl.t.z()));
  camera_ = {P0.at<double>(0, 0), P0.at<double>(1, 1), P0.at<double>(0, 2), P0.at<double>(1, 2), width, height};
  Eigen::Matrix3d to_rectified[2];
  cv::cv2eigen(R0, to_rectified[0]);
  cv::cv2eigen(R1, to_rectified[1]);
  T_left_.R = to_rectified[0].transpose();
  left_.emplace(left, rig.left.distortion, camera_, to_rectified[0]);
  right_.emplace(right, rig.right.distortion, camera_, to_rectified[1]);
  const int disparities = (width / kShareOfWidth + 15) / 16 * 16;
  const int p = kBlock * kBlock;
  matcher_ = cv::StereoSGBM::create(0, disparities, kBlock, 8 * p, 32 * p, 1, 31, 10, 100, 2, cv::StereoSGBM::MODE_SGBM_3WAY);
}

cv::Mat StereoDepth::depth(const cv::Mat& rectified_left, const cv::Mat& right) const {
  cv::Mat disparity;
  matcher_->compute(grey_8bit(rectified_left), grey_8bit(right_->image(right)), disparity);  // sixteenths of a pixel
  cv::Mat depth = cv::Mat::zeros(disparity.size(), CV_32FC1);
  const cv::Mat& seen = left_->seen();
  const auto fb = static_cast<float>(camera_.fx * baseline_);
  for (int v = 0; v < depth.rows; ++v)
    for (int u = 0; u < depth.cols; ++u) {
      const float d = static_cast<float>(disparity.at<int16_t>(v, u)) / 16;
      if (d > 0.5f && (seen.empty() || seen.at<uint8_t>(v, u))) depth.at<float>(v, u) = fb / d;
    }
  return depth;
}

}  // namespace iclk
