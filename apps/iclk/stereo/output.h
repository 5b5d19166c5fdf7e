#pragma once
#include <string>

#include "apps/iclk/stereo/run.h"

namespace iclk {

/// result.json: the extrinsics with covariance, what was seen of them, one entry a pair.
std::string result_json(const StereoRunOptions& options, const StereoReport& report);

/// series.csv: time, T_rl as tx ty tz qx qy qz qw, deviations of translation and rotation vector, valid.
std::string series_csv(const StereoReport& report);

/// A pair rectified by both extrinsics, above and below, with every tenth part of the height as a line through both images.
cv::Mat epipolar_picture(const StereoImages& images, const Camera& camera, const SE3& before, const SE3& after);

}  // namespace iclk
