#pragma once
#include <cstdint>
#include <vector>

namespace iclk {

/// The smaller eigenvalue of the gradient matrix (Sobel, 3x3), summed over 7x7 pixels, at each of width x height pixels, row by
/// row: what cv::cornerMinEigenVal(grey, 7, 3) gives, with the same roundings, so that corners are ordered alike. 4 for a mean
/// matrix with an eigenvalue of 1 (grey / px)^2, grey in [0, 1]. Pixels are mirrored at the border, which is not repeated.
std::vector<float> corner_response(const std::vector<uint8_t>& grey, int width, int height);

}  // namespace iclk
