#pragma once
#include <iclk/align/model_file.h>

namespace iclk::test {

/// Two levels and an M-estimator, all weights the same.
inline Model tiny_model() {
  const auto layer = [](int in, int out, int dilation) {
    return ConvLayer{in, out, dilation, std::vector<float>(static_cast<size_t>(9 * in * out), 0.1f),
                     std::vector<float>(static_cast<size_t>(out))};
  };
  Model model;
  model.name = "tiny";
  model.licence = "CC0-1.0";
  model.provenance = "made by a test";
  model.mean = {0.5f, 0.4f, 0.3f};
  model.std = {0.2f, 0.2f, 0.25f};
  model.encoder = {{layer(3, 4, 1), layer(4, 8, 2)}, {layer(8, 16, 1)}};
  model.m_estimator = {layer(4, 2, 1), layer(2, 1, 4)};
  return model;
}

}  // namespace iclk::test
