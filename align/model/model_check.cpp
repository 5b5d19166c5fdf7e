#include <iclk/align/model/model_check.h>

#include <algorithm>
#include <cmath>
#include <string>

#include <iclk/align/common/text.h>
#include <iclk/engine/error.h>

namespace iclk::internal {
namespace {

[[noreturn]] void refuse(const std::string& why) { throw Error(ErrorCode::invalid_argument, why); }

void need_range(const std::string& what, double value, double least, double most) {
  if (value >= least && value <= most) return;
  refuse(what + " is " + text_of(value) + ", must be " + text_of(least) + " to " + text_of(most));
}

/// Returns the output channels of the layer.
int check_layer(const std::string& name, const ConvLayer& layer, int in) {
  if (layer.in != in)
    refuse(name + " takes " + std::to_string(layer.in) + " channels, but its input has " + std::to_string(in));
  need_range("channels of " + name, layer.out, 1, kMaxChannels);
  need_range("dilation of " + name, layer.dilation, 1, kMaxDilation);
  const size_t weights = size_t{9} * static_cast<size_t>(layer.in) * static_cast<size_t>(layer.out);
  if (layer.weight.size() != weights || layer.bias.size() != static_cast<size_t>(layer.out))
    refuse(name + " has " + std::to_string(layer.weight.size()) + " weights and " + std::to_string(layer.bias.size()) +
           " biases, but " + std::to_string(layer.in) + " to " + std::to_string(layer.out) + " channels need " +
           std::to_string(weights) + " and " + std::to_string(layer.out));
  const auto finite = [](float x) { return std::isfinite(x); };
  if (!std::all_of(layer.weight.begin(), layer.weight.end(), finite) ||
      !std::all_of(layer.bias.begin(), layer.bias.end(), finite))
    refuse(name + " has a weight or bias that is NaN or infinite: the training diverged, or the file is damaged");
  return layer.out;
}

}  // namespace

void check_model(const Model& model) {
  if (model.input_channels != 1 && model.input_channels != 3)
    refuse("input_channels is " + std::to_string(model.input_channels) + ", must be 1 (luma) or 3 (RGB)");
  for (int c = 0; c < model.input_channels; ++c) {
    const float mean = model.mean[static_cast<size_t>(c)], std = model.std[static_cast<size_t>(c)];
    need_range("mean of channel " + std::to_string(c), mean, -1e3, 1e3);
    need_range("std of channel " + std::to_string(c), std, 1e-6, 1e3);
  }
  need_range("iterations", model.iterations, 1, 100);
  need_range("damping", model.damping, 0, 1e6);
  need_range("carry", model.carry, 0, 1);
  need_range("number of encoder levels", model.levels(), 1, kMaxModelLevels);
  int channels = model.input_channels;
  for (size_t level = 0; level < model.encoder.size(); ++level) {
    const auto& layers = model.encoder[level];
    const std::string name = "encoder level " + std::to_string(level);
    need_range("number of layers of " + name, static_cast<double>(layers.size()), 1, kMaxLevelLayers);
    for (size_t i = 0; i < layers.size(); ++i)
      channels = check_layer(name + " layer " + std::to_string(i), layers[i], channels);
  }
  if (!model.m_estimator.empty()) {
    need_range("number of layers of the M-estimator", static_cast<double>(model.m_estimator.size()), 1, kMaxLevelLayers);
    channels = 4;
    for (size_t i = 0; i < model.m_estimator.size(); ++i)
      channels = check_layer("M-estimator layer " + std::to_string(i), model.m_estimator[i], channels);
    if (channels != 1) refuse("the last layer of the M-estimator gives " + std::to_string(channels) + " channels, must give 1");
  }
  if (model.parameters() > kMaxModelParameters)
    refuse("the model has " + std::to_string(model.parameters()) + " parameters, but at most " +
           std::to_string(kMaxModelParameters) + " are allowed");
}

void check_model_use(const Model& model, const AlignerOptions& options) {
  if (options.levels > model.levels())
    refuse("levels is " + std::to_string(options.levels) + ", but the model" + (model.name.empty() ? "" : " " + model.name) +
           " has " + std::to_string(model.levels()) + "; use that many or fewer");
  if (options.robust != Robust::unit && !model.m_estimator.empty())
    refuse("robust weights cannot be used with this model, whose M-estimator computes the weights; use robust=unit");
}

}  // namespace iclk::internal
