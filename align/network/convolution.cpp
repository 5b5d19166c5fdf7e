#include <iclk/align/network/convolution.h>

#include <algorithm>
#include <bit>
#include <cstring>

#include <iclk/align/common/each.h>
#include <iclk/engine/submission.h>

#include "conv_border.comp.spv.h"
#include "conv_direct.comp.spv.h"
#include "conv_direct_shared.comp.spv.h"
#include "winograd4_fused.comp.spv.h"
#include "winograd4x1.comp.spv.h"
#include "winograd4x1_fused.comp.spv.h"

namespace iclk::internal {
namespace {

constexpr uint32_t kBlock = ICLK_CONV_CHANNELS;
constexpr uint32_t kTileSize = 4;  // output pixels per side of Winograd's tiles
constexpr uint32_t kBorderLanes = 64;
constexpr uint32_t kTileLanes = 8;  // of a workgroup of whole tiles, a power of two

// The number of tiles of all images, and of one sub-grid in x and y. Four sub-grids of an even dilation fill a workgroup: see
// shaders/convolution/winograd_tile.glsl.
struct Tiles {
  explicit Tiles(const ConvStep& step) {
    const uint32_t span = kTileSize * step.dilation;
    x = engine::groups_for(step.out.width, span);
    y = engine::groups_for(step.out.height, span);
    all = static_cast<uint64_t>(x) * y * step.dilation * step.dilation * step.out.images;
    if (step.dilation % 2 == 0) all = (all / 4 + kTileLanes - 1) / kTileLanes * kTileLanes * 4;
  }
  uint32_t x, y;
  uint64_t all;
};

static_assert(ICLK_WINOGRAD_TILES == 4, "an invocation has the tiles of 2x2 sub-grids");

constexpr uint64_t kGroupTiles = static_cast<uint64_t>(ICLK_WINOGRAD_TILES) * kTileLanes;
uint64_t tile_texels(const ConvStep& step) { return static_cast<uint64_t>(positions(step.variant)) * step.in.planes(); }
uint64_t fused_texels(const ConvStep& step) {
  if (!of_whole_tiles(step.variant)) return ICLK_FUSED_WORK_TEXELS;
  return ICLK_FUSED_WORK_TEXELS + ICLK_FUSED_SLOTS * kGroupTiles * tile_texels(step);
}

// The most blocks of output channels of a fused step's work item; 0: none. lavapipe silently ends the loops of an invocation
// after 65,535 iterations in all.
uint64_t most_item_blocks(const ConvStep& step) {
  constexpr uint64_t turns = 50'000;
  const uint64_t m = kTileSize + 2, planes = step.in.planes(), transform = ICLK_WINOGRAD_TILES * (1 + planes * (1 + m)),
                 block = 1 + m * (1 + m * ((planes + 1) / 2)) + std::max<uint64_t>(m, ICLK_WINOGRAD_TILES);
  return transform < turns ? (turns - transform) / block : 0;
}

// Smaller items if there are too few for all threads, although each item repeats the transformation of its tiles.
uint32_t item_blocks(const ConvStep& step, uint64_t groups) {
  const uint64_t blocks = engine::groups_for(step.out.channels, kBlock), wanted = 2 * cores(),
                 parts = std::clamp<uint64_t>((wanted + groups - 1) / groups, 1, blocks);
  return static_cast<uint32_t>(std::min(most_item_blocks(step), (blocks + parts - 1) / parts));
}

// The number of invocations per column of the image, with `rows` pixels each.
uint64_t invocations(uint32_t height, uint32_t dilation, uint32_t rows) {
  return static_cast<uint64_t>(engine::groups_for(height, rows * dilation)) * dilation;
}

}  // namespace

uint64_t TensorLayout::texels() const {
  const uint64_t beyond = static_cast<uint64_t>(pitch()) * border * (ICLK_CONV_MOST_ROWS + 2) + pitch();
  return offset() + static_cast<uint64_t>(plane()) * planes() * images + beyond;
}

bool can_reduce(const ConvStep& step) {
  if (!step.fused) return false;
  return of_whole_tiles(step.variant) ? step.dilation % 2 == 0 : FusedColumns::can_reduce(step);
}

bool can_fuse(const ConvStep& step, const engine::Context& context) {
  const VkPhysicalDeviceLimits& limits = context.limits();
  return step.variant != ConvVariant::direct && context.info().type == engine::DeviceType::cpu && can_shuffle(context.info()) &&
         fused_texels(step) <= std::min<uint64_t>(limits.maxStorageBufferRange / 16, limits.maxTexelBufferElements) &&
         (!of_whole_tiles(step.variant) || most_item_blocks(step) > 0);
}

bool has_kernel(const ConvStep& step, const engine::Context& context) {
  switch (step.variant) {
    case ConvVariant::direct: return true;
    case ConvVariant::winograd4: return can_fuse(step, context) && !context.storage_reads();
    case ConvVariant::winograd4x1: return can_shuffle(context.info());
  }
  return false;
}

ChannelSums channel_sums(const ConvStep& step) {
  ChannelSums sums;
  sums.offset = static_cast<uint32_t>(step.half.width ? step.half.texels() : 0);
  sums.pitch = (step.out.width + 1) / 2;
  sums.plane = sums.pitch * ((step.out.height + 1) / 2);
  sums.planes = engine::groups_for(step.out.channels, kBlock);
  return sums;
}

ConvKernels::ConvKernels(std::shared_ptr<const engine::Context> context, std::span<const ConvStep> steps)
    : type_(context->info().type),
      direct_lanes_(type_ == engine::DeviceType::cpu ? 32 : 128),
      column_lanes_(type_ == engine::DeviceType::cpu ? 32 : 64) {
  using enum engine::BindingKind;
  using Spirv = engine::ShaderCode;
  const bool shared = type_ != engine::DeviceType::cpu || !can_shuffle(context->info());
  engine::KernelBatch wanted(context);
  wanted.add(border_,
             {"encode", conv_border_comp_spv, {storage_write, storage_write}, sizeof(shaders::BorderPush), {kBorderLanes}});
  const auto columns = [&](engine::Kernel& kernel, Spirv spirv, std::vector<uint32_t> constants) {
    wanted.add(kernel, {"encode", spirv, {texel_read, texel_read, storage_write}, sizeof(shaders::ConvPush), constants});
  };
  for (const ConvStep& step : steps) switch (step.variant) {
      case ConvVariant::direct:
        columns(direct_[direct_rows(step) - 1], shared ? conv_direct_shared_comp_spv : conv_direct_comp_spv,
                {direct_lanes_, direct_rows(step)});
        break;
      case ConvVariant::winograd4x1:
        if (step.fused)
          wanted.add(fused_columns_[FusedColumns::kernel_of(step)], FusedColumns::description(step));
        else
          columns(column_, winograd4x1_comp_spv, {column_lanes_});
        break;
      case ConvVariant::winograd4:
        wanted.add(tiles_[step.reduced], {"encode",
                                          winograd4_fused_comp_spv,
                                          {image_read, image_read, storage_write, storage_read_write, texel_read},
                                          sizeof(shaders::WinogradPush),
                                          {kTileLanes, step.reduced}});
        break;
    }
  wanted.make();
}

// Tall tiles have the fewest fetches. Small images have too few of them to occupy a GPU, and integrated GPUs have fewer
// registers. The choice follows from one image, so that results do not depend on the number of images.
uint32_t ConvKernels::direct_rows(const ConvStep& step) const {
  constexpr uint64_t kBusy = 16384;
  if (type_ == engine::DeviceType::cpu) return ICLK_CONV_ROWS;
  const uint64_t columns = static_cast<uint64_t>(step.out.width) * engine::groups_for(step.out.channels, kBlock);
  uint32_t rows = type_ == engine::DeviceType::discrete ? ICLK_CONV_MOST_ROWS : ICLK_CONV_ROWS;
  while (rows > 1 && invocations(step.out.height, step.dilation, rows) * columns < kBusy) rows /= 2;
  return rows;
}

uint64_t ConvKernels::scratch_texels(const ConvStep& step) { return step.fused ? fused_texels(step) : 0; }

void ConvKernels::record(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in,
                         const engine::Buffer& weights, const engine::Buffer& out, const engine::Buffer& scratch,
                         const MapPlace& place, std::span<const MapPart> parts) const {
  if (of_whole_tiles(step.variant))
    record_tiles(recorder, step, in, weights, out, scratch);
  else if (step.fused)
    fused_columns_.record(recorder, step, in, weights, out, scratch, place, parts);
  else
    record_columns(recorder, step, in, weights, out);
}

void ConvKernels::record_tiles(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in,
                               const engine::Buffer& weights, const engine::Buffer& out, const engine::Buffer& scratch) const {
  const Tiles tiles(step);
  const TensorLayout& to = step.reduced ? step.half : step.out;
  const uint64_t groups = (tiles.all + kGroupTiles - 1) / kGroupTiles;
  shaders::WinogradPush push{};
  set_layer(push, step, 0, to);
  push.lane_bits = static_cast<uint32_t>(std::countr_zero(kTileLanes));
  push.halves = step.half.width > 0 && step.half.height > 0;
  push.sums = step.reduced ? channel_sums(step).offset : 0;
  push.tiles_x = tiles.x;
  push.tiles_y = tiles.y;
  push.tiles = static_cast<uint32_t>(tiles.all);
  push.item_blocks = item_blocks(step, groups);
  push.counter = step.counter;
  const uint32_t blocks = engine::groups_for(step.out.channels, kBlock);
  // Twice as many workgroups as items, so that one of two threads can do all items if the other is delayed.
  recorder.dispatch(tiles_[step.reduced], {&scratch, &weights, &out, &scratch, &in}, push,
                    spread(1, 2 * groups * engine::groups_for(blocks, push.item_blocks), 1));
}

void ConvKernels::record_columns(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in,
                                 const engine::Buffer& weights, const engine::Buffer& out) const {
  shaders::ConvPush push{};
  set_layer(push, step, step.dilation * (step.in.pitch() + 1), step.out);
  const bool direct = step.variant == ConvVariant::direct;
  const uint32_t tall = direct ? direct_rows(step) : 4 * ICLK_COLUMN_TILES;
  recorder.dispatch(
      direct ? direct_[tall - 1] : column_, {&in, &weights, &out}, push,
      spread(engine::groups_for(step.out.channels, kBlock),
             invocations(push.height, push.dilation, tall) * push.width * push.images, direct ? direct_lanes_ : column_lanes_));
}

void ConvKernels::record_start(engine::Recorder& recorder, const engine::Buffer& scratch) const {
  recorder.fill(scratch, 0, 0, 16 * ICLK_FUSED_WORK_TEXELS);
}

void ConvKernels::record_borders(engine::Recorder& recorder, const TensorLayout& in_first, const TensorLayout& in_second,
                                 const engine::Buffer& first, const engine::Buffer& second) const {
  const uint32_t planes[] = {in_first.planes() * in_first.images, in_second.planes() * in_second.images};
  const TensorLayout& any = planes[0] > 0 ? in_first : in_second;
  const shaders::BorderPush push{any.height, any.offset(), any.pitch(), any.plane(), any.border, {planes[0], planes[1]}};
  recorder.dispatch(border_, {&first, &second}, push,
                    {engine::groups_for((any.height + any.pitch()) * any.border, kBorderLanes),
                     1 + std::max(planes[0], planes[1]), planes[1] > 0 ? 2u : 1u});
}

void ConvKernels::add_to(engine::ArenaSize& size) const {
  // Activations alternate between two buffers.
  size.add(border_, 2);
  for (const engine::Kernel& kernel : direct_)
    if (kernel) size.add(kernel, 2);
  if (column_) size.add(column_, 2);
  fused_columns_.add_to(size);
  for (const engine::Kernel& kernel : tiles_)
    if (kernel) size.add(kernel, 2);
}

bool can_shuffle(const engine::DeviceInfo& info) {
  return info.subgroup_size >= kBlock && (info.subgroup_operations & VK_SUBGROUP_FEATURE_SHUFFLE_BIT) != 0;
}

engine::Groups spread(uint32_t x, uint64_t count, uint32_t lanes) {
  const uint64_t groups = (count + lanes - 1) / lanes;
  constexpr uint64_t most = 32768;  // every device has 65,535
  const uint64_t y = std::min(groups, most);
  return {x, static_cast<uint32_t>(y), static_cast<uint32_t>(y ? (groups + y - 1) / y : 0)};
}

void write_buffer(const std::shared_ptr<const engine::Context>& context, const engine::Buffer& buffer,
                  std::span<const float> data) {
  if (data.empty()) return;
  if (buffer.mapped) {
    std::memcpy(buffer.mapped, data.data(), data.size_bytes());
    return;
  }
  engine::MemoryPlan plan;
  const auto id = plan.add("weights staging", data.size_bytes(), engine::MemoryKind::upload, engine::BufferUse::transfer);
  const engine::Workspace staging(context, plan);
  std::memcpy(staging[id].mapped, data.data(), data.size_bytes());
  engine::Submission submission(context);
  engine::DescriptorArena arena(context, {});
  engine::Recorder recorder(submission, arena);
  recorder.copy(staging[id], buffer, data.size_bytes());
  submission.end();
  submission.submit_and_wait();
}

}  // namespace iclk::internal
