#pragma once
#include <vector>

#include <iclk/align/image.h>

namespace iclk::internal {

/// An image of floats, with a view of it.
struct FloatImage {
  std::vector<float> pixels;
  ImageView view;
};

/// The grey values of an image with the local mean removed and the local contrast made even:
///
///   0.5 + 0.16 (grey - mean) / (deviation + 0.016),   clamped to [0, 1]
///
/// Mean and standard deviation have Gaussian weights of 1.6 % of the image's width. Slow changes of light, such as haze, shadow
/// and vignetting, leave the result as it is. Pixels that are not finite stay so. Pixels where the mask is 0 do not count; an
/// empty mask hides nothing.
FloatImage local_contrast(const ImageView& image, const ImageView& mask = {});

}  // namespace iclk::internal
