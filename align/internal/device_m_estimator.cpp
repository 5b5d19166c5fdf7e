#include <iclk/align/internal/device_m_estimator.h>

#include <algorithm>

#include <iclk/shaders/shared.h>

#include "conv_patch.comp.spv.h"
#include "conv_patch_plain.comp.spv.h"
#include "m_estimator_input.comp.spv.h"
#include "m_estimator_patch.comp.spv.h"
#include "m_estimator_weights.comp.spv.h"

namespace iclk::internal {
namespace {

constexpr uint32_t kLanes = 64;
constexpr uint64_t kTexel = 16, kInputTexel = 8;
// Of the pairs that are in work at a time, and of the patches.
constexpr uint64_t kInputBytes = 64ull << 20, kPatchBytes = 64ull << 20;

uint32_t planes(uint32_t channels) { return (channels + 3) / 4; }

}  // namespace

MEstimator::MEstimator(const engine::Context& context, std::shared_ptr<const Model> model, const Layout& layout,
                       const Plan& plan, int batch, engine::MemoryPlan& memory)
    : model_(std::move(model)),
      levels_(layout.levels),
      dense_(plan.dense),
      max_features_(static_cast<uint32_t>(plan.max_features)),
      element_stride_(layout.element_stride),
      map_stride_(layout.map_stride),
      weight_stride_(layout.weight_stride),
      lanes_(context.info().type == engine::DeviceType::cpu ? 32 : 64) {
  // The output of the last layer is the patch; each layer before sees a dilation more on every side.
  uint64_t weights = 0, texels[2] = {0, 0};
  uint32_t in_channels = 4;
  for (const ConvLayer& layer : model_->m_estimator) margin_ += static_cast<uint32_t>(layer.dilation);
  uint32_t margin = margin_, side = ICLK_PATCH + 2 * margin_, beyond = 0;
  texels[0] = static_cast<uint64_t>(side) * side;
  for (size_t i = 0; i < model_->m_estimator.size(); ++i) {
    const ConvLayer& from = model_->m_estimator[i];
    Layer layer{};
    layer.dilation = static_cast<uint32_t>(from.dilation);
    beyond = std::max(beyond, side * layer.dilation * (ICLK_CONV_ROWS + 2));
    margin -= layer.dilation;
    side = ICLK_PATCH + 2 * margin;
    layer.margin = margin;
    layer.side = side;
    layer.in_planes = planes(in_channels);
    layer.out_channels = in_channels = static_cast<uint32_t>(from.out);
    uint64_t& most = texels[(i + 1) % 2];
    most = std::max(most, static_cast<uint64_t>(side) * side * planes(in_channels));
    weights += packed_texels(from, ConvVariant::direct);
    layers_.push_back(layer);
  }

  const VkPhysicalDeviceLimits& limits = context.limits();
  const uint64_t range = std::min<uint64_t>(limits.maxStorageBufferRange / kTexel, limits.maxTexelBufferElements);
  const uint64_t pixels = static_cast<uint64_t>(levels_[0].width) * levels_[0].height;
  pairs_per_pass_ =
      static_cast<uint32_t>(std::clamp<uint64_t>(kInputBytes / (2 * kInputTexel) / pixels, 1, static_cast<uint64_t>(batch)));
  const uint64_t patches = static_cast<uint64_t>(pairs_per_pass_) * patches_per_pair(0, max_features_),
                 both = texels[0] + texels[1];
  const uint64_t fit = std::min(kPatchBytes / kTexel / both, (range - beyond) / std::max(texels[0], texels[1]));
  patches_per_chunk_ = static_cast<uint32_t>(std::clamp<uint64_t>(fit, 1, patches));
  if (levels_.size() > 1) {
    prior_origin_ = levels_[1].map_offset;
    prior_stride_ = layout.map_stride - prior_origin_;
  }
  using engine::BufferUse;
  using engine::MemoryKind;
  const auto add = [&](const char* name, uint64_t count) {
    return memory.add(name, kTexel * count, MemoryKind::device, BufferUse::storage | BufferUse::texel,
                      VK_FORMAT_R32G32B32A32_SFLOAT);
  };
  residuals_ = memory.add("M-estimator residuals", 4ull * weight_stride_ * static_cast<uint64_t>(batch), MemoryKind::device,
                          BufferUse::storage);
  // Two halves of a pixel's input: a buffer of a device with small buffers holds twice as many pixels.
  for (engine::BufferId& input : inputs_)
    input = memory.add("M-estimator input", kInputTexel * pixels * pairs_per_pass_, MemoryKind::device,
                       BufferUse::storage | BufferUse::texel, VK_FORMAT_R32G32_SFLOAT);
  prior_ = memory.add("M-estimator weight maps",
                      4 * std::max<uint64_t>(1, static_cast<uint64_t>(prior_stride_) * static_cast<uint64_t>(batch)),
                      MemoryKind::device, BufferUse::storage);
  corners_ = memory.add("M-estimator patches", 8ull * patches_per_chunk_, MemoryKind::device, BufferUse::storage);
  weights_ = add("M-estimator layers", weights);
  for (int i = 0; i < 2; ++i)
    activations_[i] = add(i == 0 ? "patch activations, even layers" : "patch activations, odd layers",
                          texels[i] * patches_per_chunk_ + beyond);
}

uint32_t MEstimator::patches_per_pair(int level, uint32_t features) const {
  const shaders::LevelInfo& info = levels_[static_cast<size_t>(level)];
  return dense_ ? engine::groups_for(info.width, ICLK_PATCH) * engine::groups_for(info.height, ICLK_PATCH)
                : std::min(features, max_features_);
}

void MEstimator::load(std::shared_ptr<const engine::Context> context, const engine::Workspace& memory, bool shuffle,
                      uint32_t sum_lanes) {
  using enum engine::BindingKind;
  PackedWeights packed;
  for (size_t i = 0; i < layers_.size(); ++i) layers_[i].packed = packed.add(model_->m_estimator[i], ConvVariant::direct);
  write_buffer(context, memory[weights_], packed.data());
  const uint32_t bytes = sizeof(shaders::MEstimatorPush);
  input_ = {context,
            {"m_estimator",
             m_estimator_input_comp_spv,
             {storage_read, storage_read, storage_read, texel_read, texel_read, storage_read, storage_read, storage_write,
              storage_write, storage_write},
             bytes,
             {kLanes}}};
  patch_ = {context,
            {"m_estimator",
             m_estimator_patch_comp_spv,
             {storage_read, storage_read, storage_read, texel_read, texel_read, storage_write, storage_write},
             bytes,
             {kLanes}}};
  convolution_ = {
      context,
      {"m_estimator",
       shuffle ? std::span<const uint32_t>(conv_patch_comp_spv) : std::span<const uint32_t>(conv_patch_plain_comp_spv),
       {texel_read, texel_read, storage_write, storage_read},
       sizeof(shaders::ConvPush),
       {lanes_}}};
  weight_ = {context,
             {"m_estimator",
              m_estimator_weights_comp_spv,
              {storage_read, storage_read, storage_read, texel_read, storage_read, storage_write, storage_write},
              bytes,
              {kLanes, sum_lanes}}};
}

void MEstimator::record(engine::Recorder& recorder, const engine::Workspace& memory, int level, uint32_t pairs,
                        uint32_t features, uint32_t flags, const Buffers& buffers) const {
  recorder.stage("m_estimator");
  const shaders::LevelInfo& info = levels_[static_cast<size_t>(level)];
  shaders::MEstimatorPush push{};
  push.level = static_cast<uint32_t>(level);
  push.element_stride = element_stride_;
  push.map_stride = map_stride_;
  push.weight_stride = weight_stride_;
  push.flags = flags;
  push.max_features = max_features_;
  push.inputs_stride = info.width * info.height;
  push.prior_stride = prior_stride_;
  push.prior_origin = prior_origin_;
  push.coarsest = static_cast<size_t>(level) + 1 == levels_.size();
  push.patches_per_pair = patches_per_pair(level, features);
  push.margin = margin_;
  push.dense = dense_;
  if (push.coarsest) recorder.fill(memory[prior_]);
  for (uint32_t first = 0; first < pairs; first += pairs_per_pass_) {
    const uint32_t count = std::min(pairs_per_pass_, pairs - first);
    push.first_pair = first;
    for (const engine::BufferId input : inputs_) recorder.fill(memory[input], 0, 0, kInputTexel * push.inputs_stride * count);
    recorder.dispatch(input_,
                      {buffers.levels, buffers.references, buffers.pairs, buffers.template_a, buffers.maps1, buffers.states,
                       &memory[prior_], &memory[residuals_], &memory[inputs_[0]], &memory[inputs_[1]]},
                      push, {engine::groups_for(info.element_count, kLanes), count, 1});
    const uint32_t patches = push.patches_per_pair * count;
    for (push.first_patch = 0; push.first_patch < patches; push.first_patch += patches_per_chunk_) {
      push.patches = std::min(patches_per_chunk_, patches - push.first_patch);
      record_patches(recorder, memory, push, buffers);
    }
  }
}

void MEstimator::record_patches(engine::Recorder& recorder, const engine::Workspace& memory,
                                const shaders::MEstimatorPush& push, const Buffers& buffers) const {
  uint32_t side = ICLK_PATCH + 2 * margin_;
  recorder.dispatch(patch_,
                    {buffers.levels, buffers.pairs, buffers.features, &memory[inputs_[0]], &memory[inputs_[1]],
                     &memory[corners_], &memory[activations_[0]]},
                    push, spread(engine::groups_for(side * side, kLanes), push.patches, 1));
  for (size_t i = 0; i < layers_.size(); ++i) {
    const Layer& layer = layers_[i];
    shaders::ConvPush conv{};
    conv.width = conv.height = layer.side;
    conv.images = push.patches;
    conv.dilation = layer.dilation;
    conv.in_pitch = side;
    conv.in_plane = side * side;
    conv.in_planes = layer.in_planes;
    conv.in_image = conv.in_plane * conv.in_planes;
    conv.out_pitch = layer.side;
    conv.out_plane = layer.side * layer.side;
    conv.out_planes = planes(layer.out_channels);
    conv.out_image = conv.out_plane * conv.out_planes;
    conv.weights = layer.packed.weights;
    conv.bias = layer.packed.bias;
    conv.margin = layer.margin;
    conv.level_width = levels_[push.level].width;
    conv.level_height = levels_[push.level].height;
    const uint64_t rows =
        static_cast<uint64_t>(engine::groups_for(layer.side, ICLK_CONV_ROWS * layer.dilation)) * layer.dilation;
    recorder.dispatch(
        convolution_, {&memory[activations_[i % 2]], &memory[weights_], &memory[activations_[(i + 1) % 2]], &memory[corners_]},
        conv, spread(engine::groups_for(layer.out_channels, ICLK_CONV_CHANNELS), rows * layer.side * push.patches, lanes_));
    side = layer.side;
  }
  recorder.dispatch(weight_,
                    {buffers.levels, buffers.pairs, &memory[corners_], &memory[activations_[layers_.size() % 2]],
                     &memory[residuals_], buffers.weights, &memory[prior_]},
                    push, {engine::groups_for(push.patches * ICLK_PATCH_AREA, kLanes), 1, 1});
}

void MEstimator::add_to(engine::ArenaSize& size) const {
  size.add(input_);
  size.add(patch_);
  size.add(convolution_, 2);
  size.add(weight_);
}

}  // namespace iclk::internal
