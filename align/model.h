#pragma once
#include <array>
#include <string>
#include <vector>

#include <iclk/align/options.h>

namespace iclk {

/// A 3x3 convolution followed by ELU. The zero padding equals the dilation; batch normalisation is folded into the weights.
struct ConvLayer {
  int in = 0, out = 0, dilation = 1;
  std::vector<float> weight;  ///< out x in x 3 x 3, row-major
  std::vector<float> bias;    ///< out
};

/// The pixels that `mean` and `std` of a model refer to.
enum class Normalisation {
  fixed,  ///< pixels in [0, 1]
  /// Pixels of an image that was normalised to zero mean and unit standard deviation, over all pixels and channels together.
  /// Deviations below 1 / 255 count as 1 / 255.
  image,
};

/// The learned model: the single-view feature pyramid of Lv et al. 2019 and their convolutional M-estimator. The model defines
/// the architecture; the paper has four levels of three layers (dilation 1, 2, 2).
///
/// Encoder: x = (pixels - mean) / std, see Normalisation. At each level l > 0, x is first halved by 2x2 means (sizes floored);
/// then the layers of the level follow. The feature map of the level is the mean over the channels of its last layer.
///
/// M-estimator: it runs once per level, at the residual r with which the level starts. Its input channels are |r|, f0, the
/// warped f1, and the weights of the coarser level (or 1), all times the mask of visible pixels. After its layers and their
/// last ELU come a sigmoid and the mask again; the result is the weight.
struct Model {
  std::string name, licence, provenance;
  int input_channels = 3;  ///< 3: RGB; 1: luma
  Normalisation normalisation = Normalisation::fixed;
  std::array<float, 3> mean{}, std{1, 1, 1};    ///< of the input channels; one channel uses the first entry
  std::vector<std::vector<ConvLayer>> encoder;  ///< the layers of each level, finest level first
  std::vector<ConvLayer> m_estimator;           ///< empty: weights are 1
  int iterations = 10;
  double damping = 1e-6, carry = 0;  ///< like `iterations`, recommended AlignerOptions

  int levels() const { return static_cast<int>(encoder.size()); }
  size_t parameters() const;
  /// The number of multiply-accumulates of the encoder for one image, with the `levels` finest levels.
  double encoder_macs(int width, int height, int levels) const;

  /// The recommended options: the levels, iterations, damping and carry of the model, unit weights (the M-estimator gives the
  /// weights), and no gain and bias.
  AlignerOptions options() const;
};

}  // namespace iclk
