#pragma once
#include <cmath>

namespace iclk {

inline constexpr double kDegree = M_PI / 180;  ///< rad

}  // namespace iclk
