#pragma once
#include <cstdint>
#include <vector>

#include <iclk/align/model.h>
#include <iclk/align/network/conv_variant.h>

namespace iclk::internal {

/// The place of a layer in the network's weights, in texels.
struct PackedLayer {
  uint32_t weights = 0, bias = 0;
};

/// The number of texels that PackedWeights::add() appends.
uint64_t packed_texels(const ConvLayer& layer, ConvVariant variant);

/// Weights of many layers in the order of the kernels: blocks of eight texels (shaders/convolution/conv_weights.glsl) with
/// channels padded by zeros, transformed for Winograd in double precision; then the biases.
class PackedWeights {
 public:
  PackedLayer add(const ConvLayer& layer, ConvVariant variant);
  const std::vector<float>& data() const { return data_; }

 private:
  std::vector<float> data_;
};

/// Whether the variant is Winograd with transformed tiles; else each invocation transforms columns.
bool of_whole_tiles(ConvVariant variant);
/// The number of weights for a pair of channels. With whole tiles: the positions of a transformed tile.
uint32_t positions(ConvVariant variant);

}  // namespace iclk::internal
