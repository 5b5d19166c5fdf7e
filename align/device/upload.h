#pragma once
#include <iclk/align/image.h>

namespace iclk::internal {

/// Converts host pixels to the device format of a plan, with rows `row_pixels` apart. `format` must be allowed in Plan::format.
/// Colours become luma for one channel; grey values are repeated for four.
void convert_pixels(const ImageView& image, PixelFormat format, uint32_t row_pixels, void* out);

}  // namespace iclk::internal
