#pragma once
#include <cmath>
#include <random>
#include <vector>

#include <iclk/align/model.h>
#include <iclk/align/network/network.h>

namespace iclk::test {

inline internal::Planes random_planes(int channels, int width, int height, unsigned seed) {
  internal::Planes out(channels, width, height);
  std::mt19937 random(seed);
  std::normal_distribution<float> normal;
  for (float& x : out.data) x = normal(random);
  return out;
}

/// Weights that keep the spread of what goes through.
inline ConvLayer random_layer(int in, int out, int dilation, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal(0, 1 / std::sqrt(9.0f * static_cast<float>(in)));
  ConvLayer layer{in, out, dilation, std::vector<float>(size_t{9} * in * out), std::vector<float>(out)};
  for (float& x : layer.weight) x = normal(random);
  for (float& x : layer.bias) x = normal(random);
  return layer;
}

/// Three layers a level (dilation 1, 2, 2) of these channels, and the M-estimator of the paper at a quarter of its width.
inline Model random_model(const std::vector<std::vector<int>>& channels, int input_channels = 3, unsigned seed = 1) {
  Model model;
  model.name = "random";
  model.licence = "public domain";
  model.provenance = "random numbers";
  model.input_channels = input_channels;
  model.mean = {0.49f, 0.48f, 0.45f};
  model.std = {0.2f, 0.19f, 0.21f};
  int in = input_channels;
  for (const auto& level : channels) {
    model.encoder.emplace_back();
    for (const int out : level) {
      model.encoder.back().push_back(random_layer(in, out, model.encoder.back().empty() ? 1 : 2, seed++));
      in = out;
    }
  }
  in = 4;
  for (const auto& [out, dilation] : std::vector<std::pair<int, int>>{{4, 1}, {8, 2}, {16, 4}, {1, 1}}) {
    model.m_estimator.push_back(random_layer(in, out, dilation, seed++));
    in = out;
  }
  return model;
}

}  // namespace iclk::test
