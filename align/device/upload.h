#pragma once
#include <iclk/align/image.h>

namespace iclk::internal {

/// Writes host pixels into a plan's device format, rows `row_pixels` apart. `format` is one of those that Plan::format allows;
/// colour becomes luma where it has one channel, a grey value is repeated where it has four.
void convert_pixels(const ImageView& image, PixelFormat format, uint32_t row_pixels, void* out);

}  // namespace iclk::internal
