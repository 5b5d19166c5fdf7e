#pragma once
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include <iclk/refine/refiner.h>

#include "apps/iclk/session/pair_input.h"

namespace iclk {

struct Picture {
  std::string file;  ///< name, without a folder
  cv::Mat image;     ///< CV_8UC3
};

/// What a result looks like, each with its legend in the picture:
/// - features.png: the target with the features where they were found, and lines to the truth, else to the first guess;
/// - overlay.png: reference and warped target in one, by the first guess and by the result;
/// - residual.png: warped target minus reference, by the first guess and by the result.
std::vector<Picture> make_pictures(const PairInput& pair, const RefinedAlignment& result);

/// Depth of every pixel that has one: the depth image, or where there is none an interpolation of the features' inverse depths
/// within their hull. CV_32FC1 metres, 0 = unknown.
cv::Mat picture_depth(const PairInput& pair);

/// The reference in red and the target, warped by T_10 and brought to the reference's exposure, in cyan: grey where they agree,
/// dark where `depth_0` (as picture_depth gives it) is unknown. CV_8UC3 of the reference's size.
cv::Mat overlay_image(const PairInput& pair, const cv::Mat& depth_0, const SE3& T_10);

/// The target as camera 0 would have seen it by T_10: CV_32FC1 grey values, NaN where the depth is unknown or the target does
/// not see it.
cv::Mat warp_target(const cv::Mat& grey_1, const cv::Mat& depth_0, const Camera& camera, const SE3& T_10);

}  // namespace iclk
