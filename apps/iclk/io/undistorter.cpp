#include "apps/iclk/io/undistorter.h"

#include <cmath>

#include <opencv2/calib3d.hpp>
#include <opencv2/core/eigen.hpp>
#include <opencv2/imgproc.hpp>

namespace iclk {
namespace {

constexpr double kLeastZ = 1e-3;  // of rays; what looks farther to the side is beyond every lens's domain

}  // namespace

cv::Mat camera_matrix(const Camera& c) { return (cv::Mat_<double>(3, 3) << c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1); }

Undistorter::Undistorter(const Camera& camera, const Distortion& distortion) : Undistorter(camera, distortion, camera) {}

Undistorter::Undistorter(const Camera& camera, const Distortion& distortion, const Camera& as, const Eigen::Matrix3d& R)
    : camera_(camera), as_(as), R_(R), distortion_(distortion), lens_(distortion) {
  const bool same = camera.fx == as.fx && camera.fy == as.fy && camera.cx == as.cx && camera.cy == as.cy &&
                    camera.width == as.width && camera.height == as.height;
  identity_ = distortion_.empty() && same && R == Eigen::Matrix3d::Identity();
  if (identity_) return;
  const cv::Mat K = camera_matrix(camera), K_as = camera_matrix(as);
  cv::Mat turn;
  cv::eigen2cv(R, turn);
  const cv::Size size(as.width, as.height);
  if (distortion_.model == Distortion::Model::equidistant)
    cv::fisheye::initUndistortRectifyMap(K, distortion_.k, turn, K_as, size, CV_32FC1, map_u_, map_v_);
  else
    cv::initUndistortRectifyMap(K, distortion_.k, turn, K_as, size, CV_32FC1, map_u_, map_v_);
  const double domain = lens_.radius();  // beyond it the model folds back
  seen_ = cv::Mat::zeros(size, CV_8UC1);
  for (int v = 0; v < size.height; ++v)
    for (int u = 0; u < size.width; ++u) {
      const float x = map_u_.at<float>(v, u), y = map_v_.at<float>(v, u);
      const Eigen::Vector3d ray = R.transpose() * as.ray({u, v});
      const double r = ray.z() > 0 ? std::hypot(ray.x(), ray.y()) / ray.z() : 1e301;
      if (x >= 0 && y >= 0 && x <= camera.width - 1 && y <= camera.height - 1 && r < domain) seen_.at<uchar>(v, u) = 255;
    }
}

cv::Mat Undistorter::image(const cv::Mat& image) const {
  if (identity_) return image;
  cv::Mat out;
  cv::remap(image, out, map_u_, map_v_, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  return out;
}

cv::Mat Undistorter::depth(const cv::Mat& depth) const {
  if (identity_) return depth;
  cv::Mat out;
  cv::remap(depth, out, map_u_, map_v_, cv::INTER_NEAREST, cv::BORDER_CONSTANT, cv::Scalar(0));
  out.setTo(0, seen_ == 0);
  if (R_ == Eigen::Matrix3d::Identity()) return out;
  for (int v = 0; v < out.rows; ++v)
    for (int u = 0; u < out.cols; ++u)
      if (float& z = out.at<float>(v, u); z > 0) z /= static_cast<float>(R_.col(2).dot(as_.ray({u, v})));
  return out;
}

void along_axis(const Camera& camera, cv::Mat& depth) {
  for (int v = 0; v < depth.rows; ++v)
    for (int u = 0; u < depth.cols; ++u) depth.at<float>(v, u) /= static_cast<float>(camera.ray({u, v}).norm());
}

void along_axis(const Camera& camera, Features& features) {
  for (size_t i = 0; i < features.uv.size(); ++i) {
    const double longer = camera.ray(features.uv[i]).norm();
    features.inverse_depth[i] *= longer;
    if (!features.inverse_depth_sigma.empty()) features.inverse_depth_sigma[i] *= longer;
  }
}

Eigen::Vector2d Undistorter::source(const Eigen::Vector2d& uv) const {
  if (identity_) return uv;
  const Eigen::Vector3d ray = R_.transpose() * as_.ray(uv);
  Eigen::Vector2d xy = ray.head<2>() / std::max(ray.z(), kLeastZ);
  if (const double r = xy.norm(); r > lens_.radius()) xy *= lens_.radius() / r;
  xy = lens_.distort(xy);
  return camera_.project({xy.x(), xy.y(), 1});
}

Eigen::Vector2d Undistorter::point(const Eigen::Vector2d& uv) const {
  if (identity_ || !uv.allFinite()) return uv;
  const cv::Mat K = camera_matrix(camera_), K_as = camera_matrix(as_);
  cv::Mat turn;
  cv::eigen2cv(R_, turn);
  const std::vector<cv::Point2d> in = {{uv.x(), uv.y()}};
  std::vector<cv::Point2d> out;
  const cv::TermCriteria until(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 100, 1e-9);
  if (distortion_.model == Distortion::Model::equidistant)
    cv::fisheye::undistortPoints(in, out, K, distortion_.k, turn, K_as);
  else
    cv::undistortPoints(in, out, K, distortion_.k, turn, K_as, until);
  return {out[0].x, out[0].y};
}

Features Undistorter::features(Features features) const {
  for (size_t i = 0; i < features.uv.size(); ++i) {
    features.uv[i] = point(features.uv[i]);
    const double longer = R_.col(2).dot(as_.ray(features.uv[i]));
    features.inverse_depth[i] *= longer;
    if (!features.inverse_depth_sigma.empty()) features.inverse_depth_sigma[i] *= longer;
  }
  return features;
}

}  // namespace iclk
