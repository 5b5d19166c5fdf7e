#pragma once
#include <cstdint>
#include <vector>

#include <iclk/align/image.h>

namespace iclk {

/// Grey values of 8 bits, row by row, rows packed: luma 0.299 R + 0.587 G + 0.114 B. What is not of 8 bits is stretched to its
/// range; all 0 where it has none, or where that is not finite.
std::vector<uint8_t> grey_8bit(const ImageView& image);

}  // namespace iclk
