#include "apps/track/stereo_depth.h"

#include <cmath>

#include <fmt/format.h>
#include <opencv2/imgproc.hpp>

#include <iclk/engine/error.h>

#include "apps/session/pair_input.h"

namespace iclk {
namespace {

constexpr int kBlock = 7;         // px
constexpr int kShareOfWidth = 6;  // disparities reach to a sixth of the image's width

cv::Matx33d matrix_of(const Camera& c) { return {c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1}; }

void rectify_map(const CameraFile& camera, const cv::Mat& R, const cv::Mat& P, cv::Size size, cv::Mat* maps) {
  const cv::Matx33d K = matrix_of(camera.camera);
  const std::vector<double>& k = camera.distortion.k;
  if (camera.distortion.model == Distortion::Model::equidistant)
    cv::fisheye::initUndistortRectifyMap(K, k, R, P, size, CV_32FC1, maps[0], maps[1]);
  else
    cv::initUndistortRectifyMap(K, k, R, P, size, CV_32FC1, maps[0], maps[1]);
}

}  // namespace

StereoDepth::StereoDepth(const StereoFile& rig, int width, int height) {
  const cv::Size size(width, height);
  const Camera left = fit_camera(rig.left, width, height), right = fit_camera(rig.right, width, height);
  CameraFile files[2] = {rig.left, rig.right};
  files[0].camera = left;
  files[1].camera = right;
  cv::Matx33d R;
  cv::Vec3d t;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) R(i, j) = rig.T_rl.R(i, j);
    t(i) = rig.T_rl.t(i);
  }
  // Lenses are undone by the maps; without them the pinholes' own centres stay where they are.
  cv::Mat R0, R1, P0, P1, Q;
  cv::stereoRectify(matrix_of(left), cv::noArray(), matrix_of(right), cv::noArray(), size, R, t, R0, R1, P0, P1, Q,
                    cv::CALIB_ZERO_DISPARITY, 0, size);
  baseline_ = -P1.at<double>(0, 3) / P1.at<double>(0, 0);
  if (!(baseline_ > 0) || !std::isfinite(baseline_))
    throw Error(
        ErrorCode::invalid_argument,
        fmt::format("the rig's right camera does not stand to the right of the left one: T_rl is [{:.4g} {:.4g} {:.4g}]", t(0),
                    t(1), t(2)));
  camera_ = {P0.at<double>(0, 0), P0.at<double>(1, 1), P0.at<double>(0, 2), P0.at<double>(1, 2), width, height};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) T_left_.R(j, i) = R0.at<double>(i, j);
  rectify_map(files[0], R0, P0, size, maps_[0]);
  rectify_map(files[1], R1, P1, size, maps_[1]);
  cv::remap(cv::Mat(size, CV_8UC1, cv::Scalar(255)), seen_, maps_[0][0], maps_[0][1], cv::INTER_NEAREST);
  const int disparities = (width / kShareOfWidth + 15) / 16 * 16;
  const int p = kBlock * kBlock;
  matcher_ = cv::StereoSGBM::create(0, disparities, kBlock, 8 * p, 32 * p, 1, 31, 10, 100, 2, cv::StereoSGBM::MODE_SGBM_3WAY);
}

cv::Mat StereoDepth::rectified(const cv::Mat& left) const {
  cv::Mat out;
  cv::remap(left, out, maps_[0][0], maps_[0][1], cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  return out;
}

cv::Mat StereoDepth::depth(const cv::Mat& rectified_left, const cv::Mat& right) const {
  cv::Mat rectified, disparity;
  cv::remap(right, rectified, maps_[1][0], maps_[1][1], cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  matcher_->compute(grey_8bit(rectified_left), grey_8bit(rectified), disparity);  // sixteenths of a pixel
  cv::Mat depth = cv::Mat::zeros(disparity.size(), CV_32FC1);
  const auto fb = static_cast<float>(camera_.fx * baseline_);
  for (int v = 0; v < depth.rows; ++v)
    for (int u = 0; u < depth.cols; ++u) {
      const float d = static_cast<float>(disparity.at<int16_t>(v, u)) / 16;
      if (d > 0.5f && seen_.at<uint8_t>(v, u)) depth.at<float>(v, u) = fb / d;
    }
  return depth;
}

}  // namespace iclk
