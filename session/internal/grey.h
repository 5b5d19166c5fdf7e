#pragma once
#include <cstdint>
#include <vector>

#include <iclk/align/image.h>

namespace iclk {

/// 8-bit grey values, row by row, rows packed: luma 0.299 R + 0.587 G + 0.114 B. Images that are not 8-bit are stretched from
/// their range to 0 .. 255. The result is all 0 if that range is empty or not finite.
std::vector<uint8_t> grey_8bit(const ImageView& image);

}  // namespace iclk
