#pragma once
#include <cmath>
#include <memory>
#include <random>
#include <vector>

#include <iclk/align/model.h>

namespace iclk::test {

/// Planar channels in double precision.
struct PlainMaps {
  int width = 0, height = 0, channels = 0;
  std::vector<double> data;
  PlainMaps(int w, int h, int c) : width(w), height(h), channels(c), data(static_cast<size_t>(w) * h * c) {}
  double& at(int c, int v, int u) { return data[(static_cast<size_t>(c) * height + v) * width + u]; }
  double at(int c, int v, int u) const { return data[(static_cast<size_t>(c) * height + v) * width + u]; }
};

/// 3x3 convolution with zero padding, bias, ELU.
inline PlainMaps convolve(const PlainMaps& x, const ConvLayer& layer) {
  PlainMaps out(x.width, x.height, layer.out);
  for (int o = 0; o < layer.out; ++o)
    for (int v = 0; v < x.height; ++v)
      for (int u = 0; u < x.width; ++u) {
        double sum = layer.bias[static_cast<size_t>(o)];
        for (int i = 0; i < layer.in; ++i)
          for (int k = 0; k < 9; ++k) {
            const int y = v + (k / 3 - 1) * layer.dilation, x0 = u + (k % 3 - 1) * layer.dilation;
            if (y < 0 || y >= x.height || x0 < 0 || x0 >= x.width) continue;
            sum += static_cast<double>(layer.weight[static_cast<size_t>((o * layer.in + i) * 9 + k)]) * x.at(i, y, x0);
          }
        out.at(o, v, u) = sum > 0 ? sum : std::expm1(sum);
      }
  return out;
}

/// Feature maps, finest first, of an image of model.input_channels channels in [0, 1].
inline std::vector<PlainMaps> encode(const Model& model, PlainMaps x, int levels) {
  std::vector<PlainMaps> maps;
  if (model.normalisation == Normalisation::image) {
    double mean = 0, variance = 0;
    for (const double value : x.data) mean += value / static_cast<double>(x.data.size());
    for (const double value : x.data) variance += (value - mean) * (value - mean) / static_cast<double>(x.data.size());
    for (double& value : x.data) value = (value - mean) / std::max(std::sqrt(variance), 1 / 255.0);
  }
  for (int c = 0; c < x.channels; ++c)
    for (int v = 0; v < x.height; ++v)
      for (int u = 0; u < x.width; ++u)
        x.at(c, v, u) = (x.at(c, v, u) - static_cast<double>(model.mean[static_cast<size_t>(c)])) /
                        static_cast<double>(model.std[static_cast<size_t>(c)]);
  for (int l = 0; l < levels; ++l) {
    if (l > 0) {
      PlainMaps half(x.width / 2, x.height / 2, x.channels);
      for (int c = 0; c < x.channels; ++c)
        for (int v = 0; v < half.height; ++v)
          for (int u = 0; u < half.width; ++u)
            half.at(c, v, u) = (x.at(c, 2 * v, 2 * u) + x.at(c, 2 * v, 2 * u + 1) + x.at(c, 2 * v + 1, 2 * u) +
                                x.at(c, 2 * v + 1, 2 * u + 1)) /
                               4;
      x = half;
    }
    for (const ConvLayer& layer : model.encoder[static_cast<size_t>(l)]) x = convolve(x, layer);
    PlainMaps mean(x.width, x.height, 1);
    for (int c = 0; c < x.channels; ++c)
      for (int v = 0; v < x.height; ++v)
        for (int u = 0; u < x.width; ++u) mean.at(0, v, u) += x.at(c, v, u) / x.channels;
    maps.push_back(mean);
  }
  return maps;
}

inline ConvLayer random_layer(int in, int out, int dilation, std::mt19937& random) {
  std::normal_distribution<float> normal;
  ConvLayer layer{in, out, dilation, {}, {}};
  layer.weight.resize(static_cast<size_t>(9 * in * out));
  layer.bias.resize(static_cast<size_t>(out));
  for (float& w : layer.weight) w = normal(random) / std::sqrt(9.0f * static_cast<float>(in));
  for (float& b : layer.bias) b = 0.3f * normal(random);
  return layer;
}

/// Odd channels, dilations and numbers of layers; four levels and an M-estimator of three layers.
inline std::shared_ptr<Model> odd_model(int input_channels = 3) {
  std::mt19937 random(5);
  auto model = std::make_shared<Model>();
  model->input_channels = input_channels;
  model->mean = {0.5f, 0.45f, 0.4f};
  model->std = {0.2f, 0.25f, 0.3f};
  int channels = input_channels;
  const auto add = [&](std::vector<ConvLayer>& layers, int out, int dilation) {
    layers.push_back(random_layer(channels, out, dilation, random));
    channels = out;
  };
  model->encoder.resize(4);
  for (const auto& [out, dilation] : {std::pair{5, 1}, {6, 3}, {9, 2}}) add(model->encoder[0], out, dilation);
  for (const auto& [out, dilation] : {std::pair{9, 2}, {13, 1}}) add(model->encoder[1], out, dilation);
  for (const auto& [out, dilation] : {std::pair{12, 1}, {17, 4}, {10, 2}, {7, 1}}) add(model->encoder[2], out, dilation);
  add(model->encoder[3], 11, 1);
  channels = 4;
  for (const auto& [out, dilation] : {std::pair{7, 2}, {10, 3}, {1, 1}}) add(model->m_estimator, out, dilation);
  for (float& w : model->m_estimator[0].weight) w *= 20;  // residuals and maps are small: let the weights differ
  return model;
}

}  // namespace iclk::test
