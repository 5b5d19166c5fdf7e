#pragma once
#include <vector>

#include "apps/iclk/depth/figures.h"
#include "apps/iclk/depth/input.h"

namespace iclk {

/// StereoSGBM (three paths and eight) and, where OpenCV has it, StereoBinarySGBM with the settings of its own samples, on the
/// rectified pair; rectified by cv::stereoRectify unless the cameras already are. "widened": with borders as wide as the
/// disparities, so that the first columns have answers too. Throws Error(unsupported) where the cameras stand one above the
/// other or one behind the other: such a pair has no horizontal rectification.
std::vector<DepthPeer> depth_peers(const DepthInput& input);

}  // namespace iclk
