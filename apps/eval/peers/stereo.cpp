#include "apps/eval/peers/stereo.h"

#include <cmath>

#include <opencv2/calib3d.hpp>
#include <opencv2/core/eigen.hpp>
#include <opencv2/imgproc.hpp>
#ifdef ICLK_OPENCV_STEREO
#include <opencv2/stereo.hpp>
#endif

#include <iclk/engine/error.h>

#include "apps/iclk/common/cpu_stopwatch.h"
#include "apps/iclk/io/images.h"
#include "apps/iclk/io/undistorter.h"

namespace iclk {
namespace {

/// A pair whose rows correspond: a point of rectified depth z has disparity u_0 - u_1 = scale / z + shift.
struct Rectified {
  cv::Mat left, right;
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();  // reference to rectified
  double fx = 0, fy = 0, cx = 0, cy = 0;            // of the rectified reference
  double scale = 0, shift = 0;
};

Rectified rectify(const DepthInput& input) {
  const Camera &a = input.camera, &b = input.cameras[0];
  const SE3& T = input.T_10[0];
  Rectified out;
  const bool aligned = T.R.isIdentity(1e-9) && std::abs(T.t.y()) + std::abs(T.t.z()) < 1e-9 * std::abs(T.t.x()) &&
                       a.fx == b.fx && a.fy == b.fy && a.cy == b.cy;
  if (aligned) {
    out.left = grey_8bit(input.reference), out.right = grey_8bit(input.targets[0]);
    out.fx = a.fx, out.fy = a.fy, out.cx = a.cx, out.cy = a.cy;
    out.scale = -a.fx * T.t.x(), out.shift = a.cx - b.cx;
    return out;
  }
  cv::Mat R, t, R_0, R_1, P_0, P_1, Q, map_u, map_v;
  cv::eigen2cv(T.R, R), cv::eigen2cv(Eigen::Vector3d(T.t), t);
  const cv::Size size = input.reference.size();
  cv::stereoRectify(camera_matrix(a), cv::noArray(), camera_matrix(b), cv::noArray(), size, R, t, R_0, R_1, P_0, P_1, Q, 0, -1);
  if (P_1.at<double>(1, 3) != 0)
    throw Error(ErrorCode::unsupported,
                "--peers: the cameras are above each other, but OpenCV's methods need them side by side; leave --peers out");
  cv::initUndistortRectifyMap(camera_matrix(a), cv::noArray(), R_0, P_0, size, CV_32FC1, map_u, map_v);
  cv::remap(grey_8bit(input.reference), out.left, map_u, map_v, cv::INTER_LINEAR);
  cv::initUndistortRectifyMap(camera_matrix(b), cv::noArray(), R_1, P_1, size, CV_32FC1, map_u, map_v);
  cv::remap(grey_8bit(input.targets[0]), out.right, map_u, map_v, cv::INTER_LINEAR);
  cv::cv2eigen(R_0, out.R);
  out.fx = P_0.at<double>(0, 0), out.fy = P_0.at<double>(1, 1), out.cx = P_0.at<double>(0, 2), out.cy = P_0.at<double>(1, 2);
  out.scale = -P_1.at<double>(0, 3), out.shift = out.cx - P_1.at<double>(0, 2);
  return out;
}

cv::Mat depth_of(const cv::Mat& disparity, double least, const Rectified& pair, const Camera& camera) {
  cv::Mat depth(camera.height, camera.width, CV_32FC1, cv::Scalar(0));
  for (int v = 0; v < depth.rows; ++v)
    for (int u = 0; u < depth.cols; ++u) {
      const Eigen::Vector3d ray = pair.R * camera.ray({u, v});
      if (ray.z() <= 0) continue;
      const double x = std::round(pair.fx * ray.x() / ray.z() + pair.cx), y = std::round(pair.fy * ray.y() / ray.z() + pair.cy);
      if (!(x >= 0 && y >= 0 && x < disparity.cols && y < disparity.rows)) continue;
      const double d = disparity.at<int16_t>(static_cast<int>(y), static_cast<int>(x)) / 16.0;
      const double w = (d - pair.shift) / pair.scale;  // 1 / rectified depth
      if (d >= least && w > 0) depth.at<float>(v, u) = static_cast<float>(1 / (w * ray.z()));
    }
  return depth;
}

}  // namespace

std::vector<DepthPeer> depth_peers(const DepthInput& input) {
  const Rectified pair = rectify(input);
  const double at_far = pair.scale / input.range.far + pair.shift, at_near = pair.scale / input.range.near + pair.shift;
  const int least = static_cast<int>(std::floor(std::min(at_far, at_near)));
  const int count = (static_cast<int>(std::ceil(std::max(at_far, at_near))) - least + 16) / 16 * 16;
  int before = 0;
  cv::Mat left = pair.left, right = pair.right;
  std::vector<DepthPeer> peers;
  const auto measure = [&](const std::string& name, const auto& compute) {
    cv::Mat disparity;
    const CpuStopwatch watch;
    compute(disparity);
    const double cpu = watch.ms() / 1000;
    if (disparity.type() != CV_16SC1) disparity.convertTo(disparity, CV_16S, 16);
    peers.push_back({name, depth_of(disparity.colRange(before, before + pair.left.cols), least, pair, input.camera), cpu});
  };
  const auto run_sgbm = [&](bool full, int block, const std::string& suffix) {
    const auto sgbm = cv::StereoSGBM::create(least, count, block, 8 * block * block, 32 * block * block, 1, 63, 10, 100, 2,
                                             full ? cv::StereoSGBM::MODE_HH : cv::StereoSGBM::MODE_SGBM_3WAY);
    measure(std::string("SGBM ") + (full ? "HH " : "3WAY ") + std::to_string(block) + suffix,
            [&](cv::Mat& disparity) { sgbm->compute(left, right, disparity); });
  };
  for (const bool full : {false, true})
    for (const int block : {5, 7}) run_sgbm(full, block, "");
#ifdef ICLK_OPENCV_STEREO
  // It knows no least disparity below 0, and fails on images whose range it does not like: then it has no line.
  try {
    if (least >= 0) {
      const auto binary = cv::stereo::StereoBinarySGBM::create(0, (least + count + 15) / 16 * 16, 9);
      binary->setP1(10), binary->setP2(100), binary->setMode(cv::stereo::StereoBinarySGBM::MODE_HH);
      binary->setBinaryKernelType(cv::stereo::CV_MODIFIED_CENSUS_TRANSFORM);
      binary->setSpekleRemovalTechnique(cv::stereo::CV_SPECKLE_REMOVAL_AVG_ALGORITHM);
      binary->setSubPixelInterpolationMethod(cv::stereo::CV_SIMETRICV_INTERPOLATION);
      measure("StereoBinarySGBM", [&](cv::Mat& disparity) { binary->compute(left, right, disparity); });
    }
  } catch (const cv::Exception&) {
  }
#endif
  // SGBM leaves out as many columns as there are disparities, unless the images are widened by them.
  before = std::max(0, least + count);
  cv::copyMakeBorder(pair.left, left, 0, 0, before, std::max(0, -least), cv::BORDER_REPLICATE);
  cv::copyMakeBorder(pair.right, right, 0, 0, before, std::max(0, -least), cv::BORDER_REPLICATE);
  for (const bool full : {false, true}) run_sgbm(full, 5, " widened");
  return peers;
}

}  // namespace iclk
