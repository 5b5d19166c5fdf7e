#pragma once
#include <memory>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include <iclk/session/session.h>

namespace iclk {

/// A pair as every method gets it; what one of them does not need does not count against it.
struct PeerPair {
  cv::Mat image_0, image_1;  ///< as load_image gives them
  cv::Mat grey_0, grey_1;    ///< CV_8UC1
  cv::Mat depth_0, depth_1;  ///< CV_32FC1 metres, NaN = none
  Camera camera;
  Features features;  ///< of image 0
  SE3 T_10;           ///< truth
  SE3 start;          ///< first guess, of iclk alone: the others start from no motion
};

/// Depth as PeerPair has it: NaN where it was not positive.
cv::Mat with_nan(const cv::Mat& depth);

struct PeerAnswer {
  bool has_pose = false;
  bool claimed = false;  ///< the method itself says that it succeeded
  SE3 T_10;
};

/// A way to find T_10. What is kept between calls (devices, memory, detectors) is made before the first.
class PeerMethod {
 public:
  /// Methods of one `family` are no witnesses for each other.
  PeerMethod(std::string family, std::string name) : family_(std::move(family)), name_(std::move(name)) {}
  virtual ~PeerMethod() = default;
  virtual PeerAnswer run(const PeerPair& pair) = 0;
  const std::string& family() const { return family_; }
  const std::string& name() const { return name_; }

 private:
  std::string family_, name_;
};

/// iclk as `iclk align` runs it, one pair at a time; claimed: Status::converged. `context`: null: Solver::cpu. `name`: in
/// tables; empty: "iclk + refine" or "iclk".
std::unique_ptr<PeerMethod> make_iclk_method(const SessionOptions& options, const std::shared_ptr<engine::Context>& context,
                                             const std::string& name = {});

/// cv::rgbd::RgbdOdometry, all settings its own: every pixel with depth of both images, four levels.
/// `threads`: of OpenCV while it runs; 0: OpenCV's own choice.
std::unique_ptr<PeerMethod> make_rgbd_odometry(int threads = 0);

/// The same features, tracked by cv::calcOpticalFlowPyrLK (21x21 windows, four levels) there and back to 1 px, and
/// cv::solvePnPRansac (MAGSAC++, 2 px, 2000 tries) with cv::solvePnPRefineLM on its inliers, of which a claim needs eight.
std::unique_ptr<PeerMethod> make_klt_pnp();

/// cv::SIFT in both images (4000 points at most), brute-force matches that pass the ratio test 0.8, depth of image 0 there,
/// and the same PnP.
std::unique_ptr<PeerMethod> make_sift_pnp();

/// The same with cv::ORB (4000 points) and Hamming distances.
std::unique_ptr<PeerMethod> make_orb_pnp();

}  // namespace iclk
