#pragma once
#include <cstddef>
#include <limits>
#include <span>

namespace iclk {

/// Sets depths that are no measurements to 0, and returns the number of pixels that are left. These are values that are not
/// finite or not positive, and values of `most` or more. The largest value of the image is one too if it marks "none" or
/// "farther". Such a marker is a number that formats use (65504; 1e9 and more). It may also be a value that 2 % of the pixels
/// have, but the next smaller value hardly any, as with saturated sensors and far planes. An image with a single value is
/// unchanged.
size_t keep_measured(std::span<float> depths, double most = std::numeric_limits<double>::infinity());

}  // namespace iclk
