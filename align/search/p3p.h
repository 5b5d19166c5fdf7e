#pragma once
#include <algorithm>
#include <array>
#include <vector>

#include <iclk/align/se3.h>

namespace iclk::internal {

/// Solves for the poses X_1 = R X_0 + t under which camera 1 sees the points along the rays, which may have any length. The
/// method is Lambda Twist (Persson and Nordberg, ECCV 2018). Returns up to four poses, with all points in front of camera 1.
/// Empty for degenerate points.
std::vector<SE3> p3p(const std::array<Eigen::Vector3d, 3>& points, const std::array<Eigen::Vector3d, 3>& rays);

}  // namespace iclk::internal
