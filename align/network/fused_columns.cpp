#include <iclk/align/network/fused_columns.h>

#include <algorithm>

#include <iclk/shaders/network/network.h>

#include "winograd4x1_fused.comp.spv.h"

namespace iclk::internal {
namespace {

// The size of a subgroup of lavapipe.
constexpr uint32_t kLanes = 8;

// The size of a work item: planes of input x blocks of output x workgroup widths. It takes about 25 us, so that all threads end
// together and the overhead per item is negligible.
constexpr uint32_t kItemWork = 32;

uint32_t blocks_of(const ConvStep& step) { return engine::groups_for(step.out.channels, ICLK_CONV_CHANNELS); }

// The two tiles of an invocation are one below the other, or two phases of an even dilation: see the shader.
bool paired(const ConvStep& step) { return step.reduced && step.dilation % 2 == 0; }

}  // namespace

uint32_t FusedColumns::kernel_of(const ConvStep& step) {
  return step.reduced ? 1 + 2 * (step.dilation % 2 == 0) + step.whole_map : 0;
}

engine::KernelDescription FusedColumns::description(const ConvStep& step) {
  using enum engine::BindingKind;
  return {"encode",
          winograd4x1_fused_comp_spv,
          {texel_read, texel_read, storage_write, storage_read_write, storage_write, storage_write},
          sizeof(shaders::ColumnPush),
          {kLanes, step.reduced, paired(step), step.whole_map}};
}

bool FusedColumns::can_reduce(const ConvStep& step) {
  // lavapipe ends the loops of an invocation after 65,535 iterations in all.
  const uint64_t turns = blocks_of(step) * (2ull + 4ull * step.in.planes());
  return (step.dilation == 1 || step.dilation % 2 == 0) && turns < 50'000;
}

void FusedColumns::add_to(engine::ArenaSize& size) const {
  // Activations alternate between two buffers; maps go to one of two buffers, or to both.
  for (uint32_t i = 0; i < kKernels; ++i)
    if (kernels_[i]) size.add(kernels_[i], i == 0 ? 2 : 2 * 4);
}

void FusedColumns::record(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in,
                          const engine::Buffer& weights, const engine::Buffer& out, const engine::Buffer& scratch,
                          const MapPlace& place, std::span<const MapPart> parts) const {
  const engine::Kernel& kernel = kernels_[kernel_of(step)];
  const uint32_t blocks = blocks_of(step);
  const TensorLayout& to = step.reduced ? step.half : step.out;
  shaders::ColumnPush push{};
  set_layer(push, step, step.dilation * (step.in.pitch() + 1), to);
  push.counter = step.counter;
  push.item_blocks = step.reduced ? blocks : std::clamp(kItemWork / push.in_planes, 1u, blocks);
  push.item_steps = std::max(kItemWork / (push.in_planes * push.item_blocks), 1u);
  const engine::Buffer* maps[] = {&out, &out};  // not written
  if (step.reduced) {
    push.halves = step.half.width > 0 && step.half.height > 0;
    set_place(push, place);
    push.inverse_channels = 1.0f / static_cast<float>(step.out.channels);
    push.split = parts.front().count;
    for (size_t i = 0; i < 2; ++i) {
      maps[i] = parts[std::min(i, parts.size() - 1)].maps;
      push.first_image[i] = parts[std::min(i, parts.size() - 1)].first_image;
    }
  }
  const uint32_t phases = paired(step) ? step.dilation / 2 : step.dilation;
  const uint32_t rows = (paired(step) ? 4 : 4 * ICLK_COLUMN_TILES) * step.dilation;
  const uint64_t items = static_cast<uint64_t>(engine::groups_for(push.height, rows)) * phases * push.images *
                         engine::groups_for(push.width, kLanes * push.item_steps) *
                         engine::groups_for(blocks, push.item_blocks);
  // Twice as many workgroups as items, so that one of two threads can do all items if the other is delayed.
  recorder.dispatch(kernel, {&in, &weights, &out, &scratch, maps[0], maps[1]}, push, spread(1, 2 * items, 1));
}

}  // namespace iclk::internal
