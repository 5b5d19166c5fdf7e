#pragma once
#include <vector>

#include <iclk/align/image.h>
#include <iclk/align/model.h>
#include <iclk/align/pyramid.h>

namespace iclk::internal {

/// Planar channels of one size: `channels` maps of width x height floats, row-major.
struct Planes {
  int channels = 0, width = 0, height = 0;
  std::vector<float> data;

  Planes() = default;
  Planes(int c, int w, int h) : channels(c), width(w), height(h), data(static_cast<size_t>(c) * w * h) {}
  size_t plane() const { return static_cast<size_t>(width) * height; }
  float* row(int channel, int v) { return data.data() + plane() * channel + static_cast<size_t>(v) * width; }
  const float* row(int channel, int v) const { return data.data() + plane() * channel + static_cast<size_t>(v) * width; }
};

/// The input of the encoder: (pixels - mean) / std, for pixels in [0, 1] or normalised by the image. Three channels are R, G
/// and B, or three times the value of a grey image; one channel is the luma.
Planes network_input(const Model& model, const ImageView& image);

/// A 3x3 convolution with zero padding as wide as its dilation, then bias and ELU. Precondition: in.channels == layer.in.
Planes convolve(const Planes& in, const ConvLayer& layer);

/// 2x2 means, sizes floored.
Planes half_size(const Planes& in);

/// The feature pyramid of an image: the `levels` finest levels of the model. Precondition: 1 <= levels <= model.levels().
Pyramid encode(const Model& model, const ImageView& image, int levels);

}  // namespace iclk::internal
