#pragma once
#include <array>
#include <string>
#include <vector>

#include <iclk/align/options.h>

namespace iclk {

/// A 3x3 convolution with zero padding of its dilation, batch normalisation folded in, followed by ELU.
struct ConvLayer {
  int in = 0, out = 0, dilation = 1;
  std::vector<float> weight;  ///< out x in x 3 x 3, row-major
  std::vector<float> bias;    ///< out
};

/// What `mean` and `std` of a model are of.
enum class Normalisation {
  fixed,  ///< pixels in [0, 1]
  image,  ///< pixels of an image that was brought to zero mean and unit deviation, over its pixels and channels together; a
          ///< deviation below 1 / 255 counts as that
};

/// The learned model: the single-view feature pyramid of Lv et al. 2019 and their convolutional M-estimator. Nothing of its
/// architecture is fixed here; the paper has four levels of three layers (dilation 1, 2, 2).
///
/// Encoder: x = (pixels - mean) / std, see Normalisation; at level l > 0 x is first halved by 2x2 means (sizes floored); then
/// the layers of the level; the feature map of the level is the mean over the channels of its last layer.
/// M-estimator, once a level at the residual with which it starts: (|r|, f0, warped f1, weight of the coarser level or 1), all
/// times the mask of visible pixels, through its layers and a sigmoid after the last ELU: the weight, times that mask.
struct Model {
  std::string name, licence, provenance;
  int input_channels = 3;                       ///< 3: RGB; 1: luma
  Normalisation normalisation = Normalisation::fixed;
  std::array<float, 3> mean{}, std{1, 1, 1};    ///< of the input; the first entry alone for one channel
  std::vector<std::vector<ConvLayer>> encoder;  ///< a level each, finest first
  std::vector<ConvLayer> m_estimator;           ///< empty: weights are 1
  int iterations = 10;
  double damping = 1e-6, carry = 0;  ///< with which it is meant to be run: AlignerOptions

  int levels() const { return static_cast<int>(encoder.size()); }
  size_t parameters() const;
  /// Multiply-accumulates of the encoder for one image, `levels` finest levels.
  double encoder_macs(int width, int height, int levels) const;

  /// Options with which this model is meant to be run: its levels, iterations, damping and carry, unit weights (the
  /// M-estimator gives them), no gain and bias.
  AlignerOptions options() const;
};

}  // namespace iclk
