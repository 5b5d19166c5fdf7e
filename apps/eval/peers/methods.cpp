#include "apps/eval/peers/methods.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/rgbd.hpp>
#include <opencv2/video/tracking.hpp>

#include "apps/iclk/io/images.h"
#include "apps/iclk/io/undistorter.h"

namespace iclk {
namespace {

/// Points of camera 0 in metres and where they are seen in image 1.
struct Correspondences {
  std::vector<cv::Point3f> X0;
  std::vector<cv::Point2f> uv1;

  void add(const Camera& camera, const cv::Point2f& uv0, double depth, const cv::Point2f& uv) {
    const Eigen::Vector3d X = depth * camera.ray({uv0.x, uv0.y});
    X0.emplace_back(static_cast<float>(X.x()), static_cast<float>(X.y()), static_cast<float>(X.z()));
    uv1.push_back(uv);
  }
};

/// MAGSAC++ and Levenberg-Marquardt on its inliers: of OpenCV's ways the one that served all three kinds of matches best. Its
/// default, EPNP in a plain RANSAC and no refinement, is several times as far off where the ground is nearly a plane.
PeerAnswer solve_pnp(const Correspondences& c, const Camera& camera) {
  constexpr size_t kLeast = 8;  // inliers of a claim
  PeerAnswer answer;
  if (c.X0.size() < kLeast) return answer;
  const cv::Mat K = camera_matrix(camera);
  cv::Vec3d rotation, translation;
  std::vector<int> inliers;
  if (!cv::solvePnPRansac(c.X0, c.uv1, K, cv::noArray(), rotation, translation, false, 2000, 2.0f, 0.9999, inliers,
                          cv::USAC_MAGSAC) ||
      inliers.size() < kLeast)
    return answer;
  std::vector<cv::Point3f> X0;
  std::vector<cv::Point2f> uv1;
  for (const int i : inliers) {
    X0.push_back(c.X0[static_cast<size_t>(i)]);
    uv1.push_back(c.uv1[static_cast<size_t>(i)]);
  }
  cv::solvePnPRefineLM(X0, uv1, K, cv::noArray(), rotation, translation);
  cv::Matx33d R;
  cv::Rodrigues(rotation, R);
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) answer.T_10.R(i, j) = R(i, j);
    answer.T_10.t(i) = translation(i);
  }
  answer.has_pose = answer.claimed = answer.T_10.R.allFinite() && answer.T_10.t.allFinite();
  return answer;
}

class Iclk final : public PeerMethod {
 public:
  Iclk(const SessionOptions& options, const std::shared_ptr<engine::Context>& context, const std::string& name)
      : PeerMethod("iclk", !name.empty()    ? name
                           : options.refine ? "iclk + refine"
                                            : "iclk"),
        session_(options, context) {}

  PeerAnswer run(const PeerPair& pair) override {
    const Reference reference{view(pair.image_0), pair.camera, pair.features, {}};
    const RefinedAlignment result = session_.align(CascadePair{reference, view(pair.image_1), pair.start});
    return {true, result.converged(), result.T_10};
  }

 private:
  Session session_;
};

class RgbdOdometry final : public PeerMethod {
 public:
  explicit RgbdOdometry(int threads)
      : PeerMethod("RgbdOdometry", threads == 0
                                       ? "RgbdOdometry"
                                       : "RgbdOdometry, " + std::to_string(threads) + (threads == 1 ? " thread" : " threads")),
        threads_(threads),
        odometry_(cv::rgbd::RgbdOdometry::create()) {}

  PeerAnswer run(const PeerPair& pair) override {
    struct Threads {  // OpenCV's number of threads is global
      int before = cv::getNumThreads();
      explicit Threads(int wanted) {
        if (wanted > 0) cv::setNumThreads(wanted);
      }
      ~Threads() { cv::setNumThreads(before); }
    } threads(threads_);
    odometry_->setCameraMatrix(camera_matrix(pair.camera));
    const double scale = scale_to_a_room(pair.depth_0);
    const cv::Mat depth_0 = scale == 1 ? pair.depth_0 : cv::Mat(pair.depth_0 * scale);
    const cv::Mat depth_1 = scale == 1 ? pair.depth_1 : cv::Mat(pair.depth_1 * scale);
    cv::Mat T;
    const bool found = odometry_->compute(pair.grey_0, depth_0, cv::Mat(), pair.grey_1, depth_1, cv::Mat(), T);
    PeerAnswer answer;
    if (T.rows != 4 || T.cols != 4 || T.type() != CV_64F || !cv::checkRange(T)) return answer;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) answer.T_10.R(i, j) = T.at<double>(i, j);
      answer.T_10.t(i) = T.at<double>(i, 3) / scale;
    }
    answer.has_pose = answer.claimed = found;
    return answer;
  }

 private:
  /// It is made for rooms: it leaves out what is more than 4 m deep, and bounds differences of depth and motions in metres.
  /// What it is given of an aerial view is a model of it, 2 m deep in the median.
  static double scale_to_a_room(const cv::Mat& depth) {
    std::vector<float> z;
    for (int y = 0; y < depth.rows; y += 8)  // its time is measured
      for (int x = 0; x < depth.cols; x += 8)
        if (const float d = depth.at<float>(y, x); std::isfinite(d) && d > 0) z.push_back(d);
    if (z.empty()) return 1;
    const auto middle = z.begin() + static_cast<std::ptrdiff_t>(z.size() / 2);
    std::nth_element(z.begin(), middle, z.end());
    return *middle > 4 ? 2 / *middle : 1;
  }

  int threads_;
  cv::Ptr<cv::rgbd::RgbdOdometry> odometry_;
};

class KltPnp final : public PeerMethod {
 public:
  KltPnp() : PeerMethod("KLT", "KLT + PnP") {}

  PeerAnswer run(const PeerPair& pair) override {
    std::vector<cv::Point2f> uv0, uv1;
    for (const Eigen::Vector2d& uv : pair.features.uv) uv0.emplace_back(static_cast<float>(uv.x()), static_cast<float>(uv.y()));
    if (uv0.empty()) return {};
    std::vector<uchar> found, found_back;
    const cv::Size window(21, 21);
    cv::calcOpticalFlowPyrLK(pair.grey_0, pair.grey_1, uv0, uv1, found, cv::noArray(), window, 3);
    std::vector<cv::Point2f> back = uv0;
    cv::calcOpticalFlowPyrLK(pair.grey_1, pair.grey_0, uv1, back, found_back, cv::noArray(), window, 3,
                             {cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 30, 0.01}, cv::OPTFLOW_USE_INITIAL_FLOW);
    Correspondences c;
    for (size_t i = 0; i < uv0.size(); ++i)
      if (found[i] && found_back[i] && cv::norm(back[i] - uv0[i]) < 1 && pair.features.inverse_depth[i] > 0)
        c.add(pair.camera, uv0[i], 1 / pair.features.inverse_depth[i], uv1[i]);
    return solve_pnp(c, pair.camera);
  }
};

class DescriptorPnp final : public PeerMethod {
 public:
  DescriptorPnp(const std::string& name, cv::Ptr<cv::Feature2D> detector, int norm)
      : PeerMethod(name, name + " + PnP"), detector_(std::move(detector)), matcher_(norm) {}

  PeerAnswer run(const PeerPair& pair) override {
    std::vector<cv::KeyPoint> keypoints_0, keypoints_1;
    cv::Mat descriptors_0, descriptors_1;
    detector_->detectAndCompute(pair.grey_0, cv::noArray(), keypoints_0, descriptors_0);
    detector_->detectAndCompute(pair.grey_1, cv::noArray(), keypoints_1, descriptors_1);
    if (descriptors_0.rows < 4 || descriptors_1.rows < 2) return {};
    std::vector<std::vector<cv::DMatch>> matches;
    matcher_.knnMatch(descriptors_0, descriptors_1, matches, 2);
    Correspondences c;
    for (const auto& m : matches) {
      if (m.size() < 2 || m[0].distance > 0.8f * m[1].distance) continue;
      const cv::Point2f uv0 = keypoints_0[static_cast<size_t>(m[0].queryIdx)].pt;
      const cv::Point at(cvRound(uv0.x), cvRound(uv0.y));
      const float depth = cv::Rect({}, pair.depth_0.size()).contains(at) ? pair.depth_0.at<float>(at) : 0;
      if (depth > 0) c.add(pair.camera, uv0, depth, keypoints_1[static_cast<size_t>(m[0].trainIdx)].pt);
    }
    return solve_pnp(c, pair.camera);
  }

 private:
  cv::Ptr<cv::Feature2D> detector_;
  cv::BFMatcher matcher_;
};

}  // namespace

cv::Mat with_nan(const cv::Mat& depth) {
  cv::Mat out = depth.clone();
  if (!out.empty()) out.setTo(std::numeric_limits<float>::quiet_NaN(), out <= 0);
  return out;
}

std::unique_ptr<PeerMethod> make_iclk_method(const SessionOptions& options, const std::shared_ptr<engine::Context>& context,
                                             const std::string& name) {
  return std::make_unique<Iclk>(options, context, name);
}
std::unique_ptr<PeerMethod> make_rgbd_odometry(int threads) { return std::make_unique<RgbdOdometry>(threads); }
std::unique_ptr<PeerMethod> make_klt_pnp() { return std::make_unique<KltPnp>(); }
std::unique_ptr<PeerMethod> make_sift_pnp() {
  return std::make_unique<DescriptorPnp>("SIFT", cv::SIFT::create(4000), cv::NORM_L2);
}
std::unique_ptr<PeerMethod> make_orb_pnp() {
  return std::make_unique<DescriptorPnp>("ORB", cv::ORB::create(4000), cv::NORM_HAMMING);
}

}  // namespace iclk
