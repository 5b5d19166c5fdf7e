#include <iclk/align/internal/device_network.h>

#include <algorithm>
#include <cmath>

#include <iclk/engine/error.h>

namespace iclk::internal {
namespace {

// Zero borders are as wide as the dilation; one beyond this is a mistake, not a network.
constexpr int kMostDilation = 64;

void check_layers(const std::vector<ConvLayer>& layers, int& channels, const std::string& what) {
  for (size_t i = 0; i < layers.size(); ++i) {
    const ConvLayer& layer = layers[i];
    const std::string which = what + ", layer " + std::to_string(i) + ": ";
    const auto refuse = [&](const std::string& why) { throw Error(ErrorCode::invalid_argument, which + why); };
    if (layer.in != channels) refuse("takes " + std::to_string(layer.in) + " channels, there are " + std::to_string(channels));
    if (layer.out < 1 || layer.out > 4096) refuse("makes " + std::to_string(layer.out) + " channels; 1 to 4096 are possible");
    if (layer.dilation < 1 || layer.dilation > kMostDilation)
      refuse("dilation " + std::to_string(layer.dilation) + "; 1 to " + std::to_string(kMostDilation) + " are possible");
    const size_t weights = 9 * static_cast<size_t>(layer.in) * static_cast<size_t>(layer.out);
    if (layer.weight.size() != weights || layer.bias.size() != static_cast<size_t>(layer.out))
      refuse(std::to_string(layer.weight.size()) + " weights and " + std::to_string(layer.bias.size()) + " biases, " +
             std::to_string(weights) + " and " + std::to_string(layer.out) + " belong to it");
    channels = layer.out;
  }
}

}  // namespace

void check_model(const Model& model, const AlignerOptions& options) {
  const auto refuse = [](const std::string& why) { throw Error(ErrorCode::invalid_argument, "model: " + why); };
  if (model.input_channels != 1 && model.input_channels != 3)
    refuse(std::to_string(model.input_channels) + " input channels; 1 (luma) and 3 (RGB) are possible");
  for (int c = 0; c < model.input_channels; ++c) {
    const float std = model.std[static_cast<size_t>(c)];
    if (!(std > 0) || !std::isfinite(std) || !std::isfinite(model.mean[static_cast<size_t>(c)]))
      refuse("the normalisation of channel " + std::to_string(c) + " is not a mean and a positive standard deviation");
  }
  if (options.levels > model.levels())
    refuse(std::to_string(model.levels()) + " levels, the options ask for " + std::to_string(options.levels) +
           "; ask for fewer, or use a deeper model");
  int channels = model.input_channels;
  for (size_t l = 0; l < model.encoder.size(); ++l) {
    if (model.encoder[l].empty()) refuse("encoder level " + std::to_string(l) + " has no layers");
    check_layers(model.encoder[l], channels, "model: encoder level " + std::to_string(l));
  }
  if (model.m_estimator.empty()) return;
  channels = 4;
  check_layers(model.m_estimator, channels, "model: M-estimator");
  if (channels != 1) refuse("the M-estimator ends with " + std::to_string(channels) + " channels; a weight is one");
  if (options.robust != Robust::unit)
    refuse("it brings its own M-estimator, which takes the place of AlignerOptions::robust; set that to Robust::unit");
}

DeviceNetwork::DeviceNetwork(const engine::Context& context, const std::shared_ptr<const Model>& model, const Layout& layout,
                             const Plan& plan, int batch, const Tuning& tuning, engine::MemoryPlan& memory) {
  if (!model) return;
  encoder.emplace(context, model, layout, plan, static_cast<uint32_t>(std::max(batch, plan.max_references)), memory, tuning);
  if (!model->m_estimator.empty()) m_estimator.emplace(context, model, layout, plan, batch, memory);
}

void DeviceNetwork::load(const std::shared_ptr<const engine::Context>& context, const engine::Workspace& memory) {
  const bool shuffle = can_shuffle(context->info());
  if (encoder) encoder->load(context, memory, shuffle);
  if (m_estimator) m_estimator->load(context, memory, shuffle);
}

void DeviceNetwork::add_to(engine::ArenaSize& size) const {
  if (encoder) encoder->add_to(size, 2);
  if (m_estimator) m_estimator->add_to(size);
}

}  // namespace iclk::internal
