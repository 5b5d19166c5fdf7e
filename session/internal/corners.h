#pragma once
#include <cstdint>
#include <vector>

namespace iclk {

/// The corner response of each of width x height pixels, row by row: the smaller eigenvalue of the gradient matrix (Sobel, 3x3)
/// summed over 7x7 pixels. It equals `cv::cornerMinEigenVal(grey, 7, 3)`, with the same rounding, so that corners have the same
/// order. It is 4 for a mean matrix with an eigenvalue of 1 (grey / px)^2, grey in [0, 1]. Pixels are mirrored at the border
/// without repeating it.
std::vector<float> corner_response(const std::vector<uint8_t>& grey, int width, int height);

}  // namespace iclk
