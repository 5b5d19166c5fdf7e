#pragma once
#include <span>
#include <string>

#include <opencv2/core.hpp>

#include <iclk/align/camera.h>
#include <iclk/align/se3.h>

namespace iclk {

/// What another method made of the reference and the first target.
struct DepthPeer {
  std::string name;
  cv::Mat depth;     ///< of the reference's pixels, CV_32FC1 metres, 0: none
  double cpu_s = 0;  ///< of computing it alone
};

/// A depth map beside its truth, over the pixels whose depth is known (CV_32FC1 metres, 0: none).
struct DepthFigures {
  int known = 0;                ///< pixels with truth
  double completeness = 0;      ///< share of them that have an answer
  double seen = 0;              ///< share of them that lie in a view, hidden there or not
  double seen_answered = 0;     ///< share of those that have an answer
  double median_error = 0;      ///< relative, of the answers
  double bad_1 = 0, bad_2 = 0;  ///< share of all known pixels without an answer within 1 and 2 px (of place in the first view)
  double bad_2_of_answers = 0;  ///< the same of the answers
};

/// `views` and `T_10` are of one length, at least 1.
DepthFigures depth_figures(const cv::Mat& depth, const cv::Mat& truth, const Camera& camera, std::span<const Camera> views,
                           std::span<const SE3> T_10);

/// One line: "bad-2.0 8.31 % (answers: 2.20 %)  bad-1.0 ...".
std::string to_text(const DepthFigures& figures);

}  // namespace iclk
