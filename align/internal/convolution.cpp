#include <iclk/align/internal/convolution.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>

#include <iclk/engine/submission.h>

#include "conv_border.comp.spv.h"
#include "conv_direct.comp.spv.h"
#include "conv_direct_plain.comp.spv.h"
#include "winograd2_input.comp.spv.h"
#include "winograd2_product.comp.spv.h"
#include "winograd2_product_plain.comp.spv.h"
#include "winograd4_input.comp.spv.h"
#include "winograd4_product.comp.spv.h"
#include "winograd4_product_plain.comp.spv.h"
#include "winograd4x1.comp.spv.h"
#include "winograd4x1_plain.comp.spv.h"
#include "winograd6_input.comp.spv.h"
#include "winograd6_product.comp.spv.h"
#include "winograd6_product_plain.comp.spv.h"

namespace iclk::internal {
namespace {

constexpr uint32_t kBlock = ICLK_CONV_CHANNELS;
// Transformed tiles of a strip: what a CPU's caches hold; elsewhere enough for all of its cores.
constexpr uint64_t kStripBytesCpu = 8ull << 20, kStripBytes = 64ull << 20;
constexpr uint32_t kBorderLanes = 64, kInputLanes = 64;

// Of whole tiles, which are transformed in a dispatch of their own.
bool in_two_parts(ConvVariant variant) { return variant != ConvVariant::direct && variant != ConvVariant::winograd4x1; }
uint32_t tile_size(ConvVariant variant) {
  return variant == ConvVariant::winograd6 ? 6 : variant == ConvVariant::winograd4 ? 4 : 2;
}
uint32_t positions(ConvVariant variant) {
  if (variant == ConvVariant::direct) return 9;
  if (variant == ConvVariant::winograd4x1) return 18;
  const uint32_t m = tile_size(variant) + 2;
  return m * m;
}
uint32_t blocks(const ConvLayer& layer) { return engine::groups_for(static_cast<uint32_t>(layer.out), kBlock); }
// Input planes for which there are weights: the products of Winograd take two at a time (shaders/winograd_product.glsl).
uint32_t weight_planes(const ConvLayer& layer, ConvVariant variant) {
  const uint32_t planes = (static_cast<uint32_t>(layer.in) + 3) / 4;
  return in_two_parts(variant) ? (planes + 1) / 2 * 2 : planes;
}

// The points at which Winograd's polynomials are multiplied, besides 0 and infinity: pairs of a sign each.
std::vector<double> point_pairs(ConvVariant variant) {
  switch (variant) {
    case ConvVariant::winograd2: return {1};
    case ConvVariant::winograd6: return {ICLK_WINOGRAD6_A, ICLK_WINOGRAD6_B, ICLK_WINOGRAD6_C};
    default: return {ICLK_WINOGRAD_A, ICLK_WINOGRAD_B};
  }
}

// G of Lavin and Gray, "Fast algorithms for convolutional neural networks": 1, x, x^2 of each point over its differences to the
// other points, so that the shaders' B^T has no divisions.
using Matrix = std::vector<std::array<double, 3>>;
Matrix kernel_transform(ConvVariant variant) {
  std::vector<double> points{0};
  for (double x : point_pairs(variant)) points.insert(points.end(), {x, -x});
  Matrix G;
  for (double x : points) {
    double f = 1;
    for (double y : points)
      if (y != x) f *= x - y;
    G.push_back({1 / f, x / f, x * x / f});
  }
  G.push_back({0, 0, 1});  // infinity
  return G;
}

// The weights of one pair of channels, as many as positions(): columns of the kernel first for `direct`, each times G for
// `winograd4x1`, else G g G^T.
std::array<float, 64> transformed(const float* g, ConvVariant variant, const Matrix& G) {
  std::array<float, 64> out{};
  const size_t m = G.size();
  if (variant == ConvVariant::direct) {
    for (size_t ky = 0; ky < 3; ++ky)
      for (size_t kx = 0; kx < 3; ++kx) out[3 * kx + ky] = g[3 * ky + kx];
    return out;
  }
  if (variant == ConvVariant::winograd4x1) {
    for (size_t kx = 0; kx < 3; ++kx)
      for (size_t i = 0; i < m; ++i) {
        double sum = 0;
        for (size_t ky = 0; ky < 3; ++ky) sum += G[i][ky] * static_cast<double>(g[3 * ky + kx]);
        out[m * kx + i] = static_cast<float>(sum);
      }
    return out;
  }
  for (size_t i = 0; i < m; ++i)
    for (size_t j = 0; j < m; ++j) {
      double sum = 0;
      for (size_t y = 0; y < 3; ++y)
        for (size_t x = 0; x < 3; ++x) sum += G[i][y] * G[j][x] * static_cast<double>(g[3 * y + x]);
      out[m * i + j] = static_cast<float>(sum);
    }
  return out;
}

// Tiles of all images, and of one sub-grid in x and y. Four sub-grids of an even dilation fill up a workgroup each: see
// shaders/winograd_tile.glsl.
struct Tiles {
  Tiles(const ConvStep& step, uint32_t lanes) {
    const uint32_t span = tile_size(step.variant) * step.dilation;
    x = engine::groups_for(step.out.width, span);
    y = engine::groups_for(step.out.height, span);
    all = static_cast<uint64_t>(x) * y * step.dilation * step.dilation * step.out.images;
    if (step.dilation % 2 == 0) all = (all / 4 + lanes - 1) / lanes * lanes * 4;
  }
  uint32_t x, y;
  uint64_t all;
};

// A power of two.
uint32_t product_lanes(engine::DeviceType type) { return type == engine::DeviceType::cpu ? 8 : 64; }
static_assert(ICLK_WINOGRAD_TILES == 4, "an invocation has the tiles of 2x2 sub-grids");

}  // namespace

uint64_t TensorLayout::texels() const {
  const uint64_t beyond = static_cast<uint64_t>(pitch()) * border * (ICLK_CONV_ROWS + 2) + pitch();
  return offset() + static_cast<uint64_t>(plane()) * planes() * images + beyond;
}

bool can_reduce(const ConvStep& step) { return in_two_parts(step.variant) && step.dilation % 2 == 0; }

ChannelSums channel_sums(const ConvStep& step, Precision precision) {
  const uint64_t means = step.half.width ? step.half.texels() * texel_bytes(precision) : 0;
  ChannelSums sums;
  sums.offset = static_cast<uint32_t>((means + 15) / 16);
  sums.pitch = (step.out.width + 1) / 2;
  sums.plane = sums.pitch * ((step.out.height + 1) / 2);
  sums.planes = engine::groups_for(step.out.channels, kBlock);
  return sums;
}

uint64_t packed_texels(const ConvLayer& layer, ConvVariant variant) {
  return static_cast<uint64_t>(blocks(layer)) *
         (static_cast<uint64_t>(positions(variant)) * weight_planes(layer, variant) * kBlock + 2);
}

PackedLayer PackedWeights::add(const ConvLayer& layer, ConvVariant variant) {
  const size_t in = static_cast<size_t>(layer.in), out = static_cast<size_t>(layer.out), n = positions(variant),
               in_planes = weight_planes(layer, variant);
  const size_t first = data_.size();
  data_.resize(first + 4 * packed_texels(layer, variant), 0.0f);
  float* to = data_.data() + first;
  const Matrix G = kernel_transform(variant);
  for (size_t o = 0; o < out; ++o)
    for (size_t i = 0; i < in; ++i) {
      const auto values = transformed(&layer.weight[(o * in + i) * 9], variant, G);
      const size_t half = o % kBlock / 4;
      for (size_t p = 0; p < n; ++p) {
        // The products of tiles walk through the planes at each position, the others through the positions of each plane.
        const size_t step = in_two_parts(variant) ? p * in_planes + i / 4 : (i / 4) * n + p;
        const size_t texel = (o / kBlock * n * in_planes + step) * kBlock + 2 * (i % 4) + half;
        to[4 * texel + o % 4] = values[p];
      }
    }
  PackedLayer packed;
  packed.weights = static_cast<uint32_t>(first / 4);
  packed.bias = packed.weights + static_cast<uint32_t>(blocks(layer) * n * in_planes * kBlock);
  std::copy(layer.bias.begin(), layer.bias.end(), data_.begin() + static_cast<std::ptrdiff_t>(4ull * packed.bias));
  return packed;
}

ConvKernels::ConvKernels(std::shared_ptr<const engine::Context> context, std::span<const ConvVariant> used, bool shuffle,
                         Precision precision)
    : precision_(precision),
      direct_lanes_(context->info().type == engine::DeviceType::cpu ? 32 : 64),
      product_lanes_(product_lanes(context->info().type)) {
  using enum engine::BindingKind;
  const uint32_t half = precision == Precision::fp16;
  const auto uses = [&](ConvVariant variant) { return std::find(used.begin(), used.end(), variant) != used.end(); };
  border_ = {context, {"encode", conv_border_comp_spv, {storage_write}, sizeof(shaders::BorderPush), {kBorderLanes, half}}};
  const auto columns = [&](std::span<const uint32_t> spirv) {
    return engine::Kernel(
        context, {"encode", spirv, {texel_read, texel_read, storage_write}, sizeof(shaders::ConvPush), {direct_lanes_, half}});
  };
  const auto winograd = [&](std::span<const uint32_t> input, std::span<const uint32_t> product) {
    constexpr uint32_t bytes = sizeof(shaders::WinogradPush);
    const auto multiply = [&](uint32_t reduced) {
      return engine::Kernel(
          context, {"encode", product, {image_read, image_read, storage_write}, bytes, {product_lanes_, half, reduced}});
    };
    return Winograd{
        {context, {"encode", input, {texel_read, storage_write}, bytes, {kInputLanes}}}, multiply(false), multiply(true)};
  };
  const auto choose = [&](std::span<const uint32_t> shared, std::span<const uint32_t> plain) {
    return shuffle ? shared : plain;
  };
  if (uses(ConvVariant::direct)) direct_ = columns(choose(conv_direct_comp_spv, conv_direct_plain_comp_spv));
  if (uses(ConvVariant::winograd4x1)) column_ = columns(choose(winograd4x1_comp_spv, winograd4x1_plain_comp_spv));
  if (uses(ConvVariant::winograd2))
    winograd_[0] = winograd(winograd2_input_comp_spv, choose(winograd2_product_comp_spv, winograd2_product_plain_comp_spv));
  if (uses(ConvVariant::winograd4))
    winograd_[1] = winograd(winograd4_input_comp_spv, choose(winograd4_product_comp_spv, winograd4_product_plain_comp_spv));
  if (uses(ConvVariant::winograd6))
    winograd_[2] = winograd(winograd6_input_comp_spv, choose(winograd6_product_comp_spv, winograd6_product_plain_comp_spv));
}

uint64_t ConvKernels::scratch_texels(const ConvStep& step, const engine::Context& context) {
  const VkPhysicalDeviceLimits& limits = context.limits();
  const engine::DeviceType type = context.info().type;
  const uint64_t bytes = type == engine::DeviceType::cpu ? kStripBytesCpu : kStripBytes;
  return scratch_texels(step, type,
                        std::min<uint64_t>({bytes, limits.maxStorageBufferRange, limits.maxTexelBufferElements * 16ull}) / 16);
}

uint64_t ConvKernels::scratch_texels(const ConvStep& step, engine::DeviceType type, uint64_t most) {
  if (!in_two_parts(step.variant)) return 0;
  const uint64_t tile = static_cast<uint64_t>(positions(step.variant)) * step.in.planes();
  const uint64_t group = ICLK_WINOGRAD_TILES * product_lanes(type);
  const uint64_t wanted = (Tiles(step, product_lanes(type)).all + group - 1) / group * group;
  return tile * std::clamp(most / tile / group * group, group, wanted);
}

void ConvKernels::record(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in,
                         const engine::Buffer& weights, const engine::Buffer& out, const engine::Buffer& scratch) const {
  if (!in_two_parts(step.variant)) return record_columns(recorder, step, in, weights, out);
  const Winograd& kernels = winograd_[tile_size(step.variant) / 2 - 1];
  const Tiles tiles(step, product_lanes_);
  const TensorLayout& to = step.reduced ? step.half : step.out;
  const uint64_t tile = static_cast<uint64_t>(positions(step.variant)) * step.in.planes(),
                 group = static_cast<uint64_t>(ICLK_WINOGRAD_TILES) * product_lanes_;
  // Small enough for a CPU's cache, and a multiple of what a workgroup takes.
  const uint64_t strip = std::min(scratch.size / 16 / tile, (tiles.all + group - 1)) / group * group;
  shaders::WinogradPush push{};
  push.width = step.out.width;
  push.height = step.out.height;
  push.images = step.out.images;
  push.dilation = step.dilation;
  push.in_offset = step.in.offset();
  push.in_pitch = step.in.pitch();
  push.in_plane = step.in.plane();
  push.in_image = step.in.image();
  push.in_planes = step.in.planes();
  push.out_offset = to.offset();
  push.out_pitch = to.pitch();
  push.out_plane = to.plane();
  push.out_image = to.image();
  push.out_planes = step.out.planes();
  push.weights = step.packed.weights;
  push.bias = step.packed.bias;
  push.lane_bits = static_cast<uint32_t>(std::countr_zero(product_lanes_));
  push.halves = step.half.width > 0 && step.half.height > 0;
  push.sums = step.reduced ? channel_sums(step, precision_).offset : 0;
  push.tiles_x = tiles.x;
  push.tiles_y = tiles.y;
  push.strip = static_cast<uint32_t>(strip);
  for (uint64_t first = 0; first < tiles.all; first += strip) {
    push.first_tile = static_cast<uint32_t>(first);
    push.tiles = static_cast<uint32_t>(std::min(strip, tiles.all - first));
    recorder.dispatch(kernels.input, {&in, &scratch}, push, {engine::groups_for(push.tiles, kInputLanes), push.in_planes, 1});
    recorder.dispatch(
        step.reduced ? kernels.reduced : kernels.product, {&scratch, &weights, &out}, push,
        {engine::groups_for(step.out.channels, kBlock), engine::groups_for(push.tiles, static_cast<uint32_t>(group)), 1});
  }
}

void ConvKernels::record_columns(engine::Recorder& recorder, const ConvStep& step, const engine::Buffer& in,
                                 const engine::Buffer& weights, const engine::Buffer& out) const {
  shaders::ConvPush push{};
  push.width = step.out.width;
  push.height = step.out.height;
  push.images = step.out.images;
  push.dilation = step.dilation;
  push.in_offset = step.in.offset() - step.dilation * (step.in.pitch() + 1);
  push.in_pitch = step.in.pitch();
  push.in_plane = step.in.plane();
  push.in_image = step.in.image();
  push.in_planes = step.in.planes();
  push.out_offset = step.out.offset();
  push.out_pitch = step.out.pitch();
  push.out_plane = step.out.plane();
  push.out_image = step.out.image();
  push.out_planes = step.out.planes();
  push.weights = step.packed.weights;
  push.bias = step.packed.bias;
  const bool direct = step.variant == ConvVariant::direct;
  const uint32_t tall = direct ? ICLK_CONV_ROWS : 4 * ICLK_COLUMN_TILES;
  const uint64_t rows = static_cast<uint64_t>(engine::groups_for(push.height, tall * push.dilation)) * push.dilation;
  recorder.dispatch(direct ? direct_ : column_, {&in, &weights, &out}, push,
                    spread(engine::groups_for(step.out.channels, kBlock), rows * push.width * push.images, direct_lanes_));
}

void ConvKernels::record_border(engine::Recorder& recorder, const TensorLayout& layout, const engine::Buffer& out) const {
  shaders::BorderPush push{layout.height, layout.offset(), layout.pitch(), layout.plane(), layout.border};
  recorder.dispatch(border_, {&out}, push,
                    {engine::groups_for((layout.height + layout.pitch()) * layout.border, kBorderLanes),
                     1 + layout.planes() * layout.images, 1});
}

void ConvKernels::add_to(engine::ArenaSize& size) const {
  // The activations go to and fro between two buffers.
  size.add(border_, 2);
  if (direct_) size.add(direct_, 2);
  if (column_) size.add(column_, 2);
  for (const Winograd& w : winograd_) {
    if (!w.input) continue;
    size.add(w.input, 2);
    size.add(w.product, 2);
    size.add(w.reduced, 2);
  }
}

uint64_t conv_shader_hash() {
  uint64_t hash = 0xcbf29ce484222325u;  // FNV-1a
  const std::span<const uint32_t> all[] = {
      conv_direct_comp_spv,       conv_direct_plain_comp_spv,       winograd2_input_comp_spv,
      winograd2_product_comp_spv, winograd2_product_plain_comp_spv, winograd4_input_comp_spv,
      winograd4_product_comp_spv, winograd4_product_plain_comp_spv, winograd6_input_comp_spv,
      winograd6_product_comp_spv, winograd6_product_plain_comp_spv, winograd4x1_comp_spv,
      winograd4x1_plain_comp_spv};
  for (const auto& words : all)
    for (uint32_t word : words) hash = (hash ^ word) * 0x100000001b3u;
  return hash;
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
  engine::Recorder recorder(*context, submission.begin(), arena);
  recorder.copy(staging[id], buffer, data.size_bytes());
  submission.end();
  submission.submit_and_wait();
}

}  // namespace iclk::internal
