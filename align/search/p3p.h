#pragma once
#include <algorithm>
#include <array>
#include <vector>

#include <iclk/align/se3.h>

namespace iclk::internal {

/// Poses X_1 = R X_0 + t under which camera 1 sees the points along the rays (any length): Lambda Twist (Persson and Nordberg,
/// ECCV 2018). Up to four; all three points lie in front of camera 1. None where the triple determines nothing.
std::vector<SE3> p3p(const std::array<Eigen::Vector3d, 3>& points, const std::array<Eigen::Vector3d, 3>& rays);

}  // namespace iclk::internal
