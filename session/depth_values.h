#pragma once
#include <cstddef>
#include <limits>
#include <span>

namespace iclk {

/// Sets what is no measurement to 0: values that are not finite or not positive, those from `most` on, and the largest one if
/// it stands for "none" or "farther": a number of formats (65504, 1e9 and more), or one that 2 % of the pixels share while
/// hardly any has the next smaller one, as saturated sensors and far planes leave it. An image of one value alone stays as it
/// is. The number of pixels that are left.
size_t keep_measured(std::span<float> depths, double most = std::numeric_limits<double>::infinity());

}  // namespace iclk
