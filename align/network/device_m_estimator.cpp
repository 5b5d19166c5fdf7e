#include <iclk/align/network/device_m_estimator.h>

#include <algorithm>

#include <iclk/shaders/shared.h>

#include "conv_patch.comp.spv.h"
#include "conv_patch_shared.comp.spv.h"
#include "m_estimator_input.comp.spv.h"
#include "m_estimator_patch.comp.spv.h"
#include "m_estimator_weights.comp.spv.h"

namespace iclk::internal {
namespace {

constexpr uint32_t kLanes = 64;
constexpr uint64_t kTexel = 16, kInputTexel = 8;
// The largest buffers of the pairs and of the patches that are processed at a time.
constexpr uint64_t kInputBytes = 64ull << 20, kPatchBytes = 64ull << 20;

uint32_t planes(uint32_t channels) { return (channels + 3) / 4; }

}  // namespace

MEstimator::MEstimator(const engine::Context& context, std::shared_ptr<const Model> model, const Layout& layout,
                       const Plan& plan, int batch, engine::MemoryPlan& memory)
    : model_(std::move(model)),
      levels_(layout.levels),
      dense_(plan.dense),
      masked_(plan.target_masks),
      max_features_(static_cast<uint32_t>(plan.max_features)),
      element_stride_(layout.element_stride),
      map_stride_(layout.map_stride),
      weight_stride_(layout.weight_stride),
      lanes_(context.info().type == engine::DeviceType::cpu ? 32 : 64) {
  // The output of the last layer is the piece; each earlier layer is larger by the dilation on every side.
  for (const ConvLayer& layer : model_->m_estimator) margin_ += static_cast<uint32_t>(layer.dilation);
  uint64_t weights = 0;
  uint32_t margin = margin_, in_channels = 4;
  for (const ConvLayer& from : model_->m_estimator) {
    Layer layer{};
    layer.dilation = static_cast<uint32_t>(from.dilation);
    layer.margin = margin -= layer.dilation;
    layer.in_planes = planes(in_channels);
    layer.out_channels = in_channels = static_cast<uint32_t>(from.out);
    weights += packed_texels(from, ConvVariant::direct);
    layers_.push_back(layer);
  }

  const VkPhysicalDeviceLimits& limits = context.limits();
  const uint64_t range = std::min<uint64_t>(limits.maxStorageBufferRange / kTexel, limits.maxTexelBufferElements);
  const uint64_t pixels = static_cast<uint64_t>(levels_[0].width) * levels_[0].height;
  pairs_per_pass_ =
      static_cast<uint32_t>(std::clamp<uint64_t>(kInputBytes / (2 * kInputTexel) / pixels, 1, static_cast<uint64_t>(batch)));
  const uint64_t patches = static_cast<uint64_t>(pairs_per_pass_) * patches_per_pair(0, max_features_);
  room_ = room_of(kPatch);
  const uint64_t fit =
      std::min(kPatchBytes / kTexel / (room_.even + room_.odd), (range - room_.beyond) / std::max(room_.even, room_.odd));
  most_pieces_ = static_cast<uint32_t>(std::clamp<uint64_t>(fit, 1, patches));
  room_.even = room_.even * most_pieces_ + room_.beyond;
  room_.odd = room_.odd * most_pieces_ + room_.beyond;
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
  // The input of a pixel is split over two buffers, so that devices with small buffers can have twice as many pixels.
  for (engine::BufferId& input : inputs_)
    input = memory.add("M-estimator input", kInputTexel * pixels * pairs_per_pass_, MemoryKind::device,
                       BufferUse::storage | BufferUse::texel, VK_FORMAT_R32G32_SFLOAT);
  prior_ = memory.add("M-estimator weight maps",
                      4 * std::max<uint64_t>(1, static_cast<uint64_t>(prior_stride_) * static_cast<uint64_t>(batch)),
                      MemoryKind::device, BufferUse::storage);
  corners_ = memory.add("M-estimator patches", 8ull * most_pieces_, MemoryKind::device, BufferUse::storage);
  weights_ = add("M-estimator layers", weights);
  activations_[0] = add("patch activations, even layers", room_.even);
  activations_[1] = add("patch activations, odd layers", room_.odd);
}

MEstimator::Room MEstimator::room_of(Size piece) const {
  Room room;
  uint64_t width = piece.width + 2 * margin_;
  room.even = width * (piece.height + 2 * margin_);
  for (size_t i = 0; i < layers_.size(); ++i) {
    const Layer& layer = layers_[i];
    room.beyond = std::max(room.beyond, width * layer.dilation * (ICLK_CONV_ROWS + 2));
    width = piece.width + 2 * layer.margin;
    uint64_t& most = i % 2 == 0 ? room.odd : room.even;
    most = std::max(most, width * (piece.height + 2 * layer.margin) * planes(layer.out_channels));
  }
  return room;
}

// Rows of a tile are `dilation` apart. On a patch a third of the rows may be empty, so the better of two heights is chosen. On
// whole levels tall tiles fetch less.
uint32_t MEstimator::rows_of(const Layer& layer, Size piece) const {
  const uint32_t height = piece.height + 2 * layer.margin;
  const auto computed = [&](uint32_t rows) { return engine::groups_for(height, rows * layer.dilation) * rows; };
  return 8 * computed(ICLK_CONV_ROWS) > 9 * computed(ICLK_CONV_ROWS - 1) ? ICLK_CONV_ROWS - 1 : ICLK_CONV_ROWS;
}

uint32_t MEstimator::pieces_that_fit(Size piece) const {
  const Room one = room_of(piece);
  if (std::min(room_.even, room_.odd) < one.beyond) return 0;
  return static_cast<uint32_t>(std::min<uint64_t>(
      {(room_.even - one.beyond) / one.even, (room_.odd - one.beyond) / one.odd, static_cast<uint64_t>(most_pieces_)}));
}

// The work in products of 4 input and 8 output channels with a tap of the kernel.
uint64_t MEstimator::work_of(Size piece) const {
  uint64_t work = 0;
  for (const Layer& layer : layers_)
    work += static_cast<uint64_t>(piece.width + 2 * layer.margin) * (piece.height + 2 * layer.margin) * layer.in_planes *
            engine::groups_for(layer.out_channels, ICLK_CONV_CHANNELS);
  return work;
}

uint32_t MEstimator::patches_per_pair(int level, uint32_t features) const {
  const shaders::LevelInfo& info = levels_[static_cast<size_t>(level)];
  return dense_ ? engine::groups_for(info.width, ICLK_PATCH) * engine::groups_for(info.height, ICLK_PATCH)
                : std::min(features, max_features_);
}

void MEstimator::load(std::shared_ptr<const engine::Context> context, const engine::Workspace& memory, uint32_t sum_lanes) {
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
             {kLanes, 0, 0, 1, 0, masked_}}};
  patch_ = {context,
            {"m_estimator",
             m_estimator_patch_comp_spv,
             {storage_read, storage_read, storage_read, texel_read, texel_read, storage_write, storage_write},
             bytes,
             {kLanes}}};
  const bool shuffle = context->info().type == engine::DeviceType::cpu && can_shuffle(context->info());
  const engine::ShaderCode convolution = shuffle ? conv_patch_comp_spv : conv_patch_shared_comp_spv;
  std::vector<Size> pieces{kPatch};
  for (const shaders::LevelInfo& level : levels_) pieces.push_back({level.width, level.height});
  for (const Layer& layer : layers_)
    for (const Size piece : pieces) {
      const uint32_t rows = rows_of(layer, piece), one = layer.out_channels == 1;
      engine::Kernel& kernel = convolutions_[rows < ICLK_CONV_ROWS][one];
      if (!kernel)
        kernel = {context,
                  {"m_estimator",
                   convolution,
                   {texel_read, texel_read, storage_write, storage_read},
                   sizeof(shaders::ConvPush),
                   {lanes_, rows, one}}};
    }
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
    record_pieces(recorder, memory, push, count, buffers);
  }
}

void MEstimator::record_pieces(engine::Recorder& recorder, const engine::Workspace& memory, shaders::MEstimatorPush push,
                               uint32_t pairs, const Buffers& buffers) const {
  const shaders::LevelInfo& info = levels_[push.level];
  const Size level{info.width, info.height};
  const uint32_t patches_per_pair = push.patches_per_pair;
  push.whole = work_of(level) < patches_per_pair * work_of(kPatch) && pieces_that_fit(level) > 0;
  const uint32_t patches_per_piece = push.whole ? patches_per_pair : 1, pieces = pairs * patches_per_pair / patches_per_piece,
                 step = pieces_that_fit(push.whole ? level : kPatch);
  for (uint32_t first = 0; first < pieces; first += step) {
    push.patches_per_pair = patches_per_pair / patches_per_piece;
    push.first_patch = first;
    push.patches = std::min(step, pieces - first);
    record_network(recorder, memory, push, push.whole ? level : kPatch, buffers);
    push.patches_per_pair = patches_per_pair;
    push.first_patch *= patches_per_piece;
    push.patches *= patches_per_piece;
    recorder.dispatch(weight_,
                      {buffers.levels, buffers.pairs, buffers.features, &memory[activations_[layers_.size() % 2]],
                       &memory[residuals_], buffers.weights, &memory[prior_]},
                      push, {engine::groups_for(push.patches * ICLK_PATCH_AREA, kLanes), 1, 1});
  }
}

void MEstimator::record_network(engine::Recorder& recorder, const engine::Workspace& memory,
                                const shaders::MEstimatorPush& push, Size piece, const Buffers& buffers) const {
  Size in{piece.width + 2 * margin_, piece.height + 2 * margin_};
  recorder.dispatch(patch_,
                    {buffers.levels, buffers.pairs, buffers.features, &memory[inputs_[0]], &memory[inputs_[1]],
                     &memory[corners_], &memory[activations_[0]]},
                    push, spread(engine::groups_for(in.width * in.height, kLanes), push.patches, 1));
  for (size_t i = 0; i < layers_.size(); ++i) {
    const Layer& layer = layers_[i];
    const Size out{piece.width + 2 * layer.margin, piece.height + 2 * layer.margin};
    shaders::ConvPush conv{};
    conv.width = out.width;
    conv.height = out.height;
    conv.images = push.patches;
    conv.dilation = layer.dilation;
    conv.in_pitch = in.width;
    conv.in_plane = in.width * in.height;
    conv.in_planes = layer.in_planes;
    conv.in_image = conv.in_plane * conv.in_planes;
    conv.out_pitch = out.width;
    conv.out_plane = out.width * out.height;
    conv.out_planes = planes(layer.out_channels);
    conv.out_image = conv.out_plane * conv.out_planes;
    conv.weights = layer.packed.weights;
    conv.bias = layer.packed.bias;
    conv.margin = layer.margin;
    conv.level_width = levels_[push.level].width;
    conv.level_height = levels_[push.level].height;
    const uint32_t tall = rows_of(layer, piece);
    const uint64_t rows = static_cast<uint64_t>(engine::groups_for(out.height, tall * layer.dilation)) * layer.dilation;
    recorder.dispatch(
        convolutions_[tall < ICLK_CONV_ROWS][layer.out_channels == 1],
        {&memory[activations_[i % 2]], &memory[weights_], &memory[activations_[(i + 1) % 2]], &memory[corners_]}, conv,
        spread(engine::groups_for(layer.out_channels, ICLK_CONV_CHANNELS), rows * out.width * push.patches, lanes_));
    in = out;
  }
}

void MEstimator::add_to(engine::ArenaSize& size) const {
  size.add(input_);
  size.add(patch_);
  for (const auto& kernels : convolutions_)
    for (const engine::Kernel& kernel : kernels)
      if (kernel) size.add(kernel, 2);
  size.add(weight_);
}

}  // namespace iclk::internal
