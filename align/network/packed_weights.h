#pragma once
#include <cstdint>
#include <vector>

#include <iclk/align/model.h>
#include <iclk/align/network/conv_variant.h>

namespace iclk::internal {

/// A layer's place in the network's weights, in texels.
struct PackedLayer {
  uint32_t weights = 0, bias = 0;
};

/// Texels that PackedWeights::add() appends.
uint64_t packed_texels(const ConvLayer& layer, ConvVariant variant);

/// Weights of many layers as the kernels read them: blocks of eight texels (shaders/convolution/conv_weights.glsl), channels
/// filled up with zeros, transformed for Winograd in double precision; then the biases.
class PackedWeights {
 public:
  PackedLayer add(const ConvLayer& layer, ConvVariant variant);
  const std::vector<float>& data() const { return data_; }

 private:
  std::vector<float> data_;
};

/// Winograd with transformed tiles; else each column of an invocation by itself.
bool of_whole_tiles(ConvVariant variant);
/// Weights of a pair of channels. Of whole tiles: the positions of a transformed one.
uint32_t positions(ConvVariant variant);

}  // namespace iclk::internal
