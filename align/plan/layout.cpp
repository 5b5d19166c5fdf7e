#include <iclk/align/plan/layout.h>

#include <algorithm>
#include <bit>
#include <string>

#include <iclk/align/search/matching.h>
#include <iclk/engine/error.h>

namespace iclk::internal {
namespace {

uint32_t round_up(uint32_t value, uint32_t step) { return (value + step - 1) / step * step; }

}  // namespace

Layout::Layout(const Plan& plan, const AlignerOptions& options, const Model* model, bool storage_reads) {
  const auto width = static_cast<uint32_t>(plan.width), height = static_cast<uint32_t>(plan.height);
  blocks_x = (width + ICLK_BLOCK - 1) / ICLK_BLOCK;
  blocks_y = (height + ICLK_BLOCK - 1) / ICLK_BLOCK;
  pixel_words = static_cast<uint32_t>(static_cast<uint64_t>(row_pixels()) * height * bytes_per_pixel(plan.format) / 4);
  learned = model;
  weighted = options.robust != Robust::unit || (model && !model->m_estimator.empty());
  // A copy of level 0 as floats would be most of the pyramid, without new information.
  level0_in_pixels = !learned && channels(plan.format) == 1 && !storage_reads;
  for (int l = 0; l < options.levels; ++l) {
    shaders::LevelInfo info{};
    info.width = width >> l;
    info.height = height >> l;
    // Levels of the fused pyramid kernel are written in whole blocks; all begin at a vec4.
    info.pitch = l < ICLK_FUSED_LEVELS ? row_pixels() >> l : info.width;
    info.map_offset = map_stride;
    if (l > 0 || !level0_in_pixels) map_stride += round_up(info.pitch * info.height, 4);
    info.element_offset = element_stride;
    info.element_count = plan.dense ? info.width * info.height : static_cast<uint32_t>(plan.max_features) * ICLK_PATCH_AREA;
    element_stride += info.element_count;
    weight_stride = std::max(weight_stride, info.element_count);
    if (!plan.dense) {
      const BlockLattice blocks = lattice(info);
      auto reached = 4 * static_cast<uint64_t>(plan.max_features);  // each patch reaches at most four
      if (plan.choose_features) {
        const Cells cells(plan);
        uint64_t anywhere = 0;
        for (uint32_t i = 0; i < cells.count(); ++i) anywhere += blocks_of(cells[i], static_cast<size_t>(l)).count();
        reached = std::max(reached, anywhere);
      }
      tile_stride += static_cast<uint32_t>(std::min(reached, static_cast<uint64_t>(blocks.columns) * blocks.rows));
      entry_stride += static_cast<uint32_t>(reached);
      most_entries = std::max(most_entries, static_cast<uint32_t>(reached));
    }
    levels.push_back(info);
  }
  weight_stride = round_up(weight_stride, 1024);  // whole blocks (shaders/align/weights.glsl) of the largest workgroup
  map_stride = std::max(map_stride, 4u);          // buffers must not be empty
  match_places = static_cast<uint32_t>(MatchLayout(plan, options).places());
  trace_stride = static_cast<uint32_t>(options.levels * options.iterations);
}

BlockLattice lattice(const shaders::LevelInfo& level) {
  // A patch of level 0 lies in the image. At level l its last pixel is at most width + 4, because width << l may be up to 2^l -
  // 1 less than the image width.
  const auto blocks = [](uint32_t pixels) { return (pixels + 4) / ICLK_BLOCK + 2; };
  return {blocks(level.width), blocks(level.height)};
}

int pairs_per_batch(const Plan& plan, const Layout& layout, const VkPhysicalDeviceLimits& limits) {
  const uint64_t range = limits.maxStorageBufferRange;
  const uint64_t texels = limits.maxTexelBufferElements;
  const auto refuse = [&](const std::string& what, uint64_t bytes, uint64_t limit) {
    throw Error(ErrorCode::unsupported, what + " of a " + std::to_string(plan.width) + "x" + std::to_string(plan.height) +
                                            " image needs " + std::to_string(bytes) + " bytes, but this device allows " +
                                            std::to_string(limit) + "; use a smaller image or the CPU solver");
  };
  const uint64_t map = 4ull * layout.map_stride, pixels = 4ull * layout.pixel_words, weights = 4ull * layout.weight_stride;
  const uint64_t level0 = layout.level_stride(0);
  if (map > range || layout.map_stride > texels) refuse("the pyramid", map, std::min(range, 4 * texels));
  if (pixels > range || level0 > texels) refuse("the pixel buffer", pixels, std::min(range, pixels / level0 * texels));
  const uint64_t elements = 16ull * layout.element_stride;
  if (elements > range) refuse("the template", elements, range);
  uint64_t pairs = std::min({range / map, texels / layout.map_stride, texels / level0, range / pixels, range / weights,
                             static_cast<uint64_t>(limits.maxComputeWorkGroupCount[1]),
                             static_cast<uint64_t>(limits.maxComputeWorkGroupCount[2])});
  const uint64_t descriptors = ICLK_MATCH_TEXELS * std::max<uint64_t>(layout.match_places, 1);  // vec4
  pairs = std::min({pairs, range / (16 * descriptors), texels / descriptors});
  // Shaders index with 32-bit integers, partly signed.
  pairs = std::min(pairs, uint64_t{0x7fffffff} / std::max({layout.map_stride, layout.level_stride(0), layout.weight_stride}));
  return static_cast<int>(std::min<uint64_t>(pairs, static_cast<uint64_t>(plan.max_pairs)));
}

WorkgroupSizes::WorkgroupSizes(const engine::DeviceInfo& device, const AlignerOptions& options) {
  const bool cpu = device.type == engine::DeviceType::cpu;
  const uint32_t largest = std::min(256u, std::bit_floor(device.max_workgroup_invocations));
  iterate = cpu ? 8 : largest;
  map = 64;
  weights = largest;
  group_elements = cpu ? 768 : 1024;  // whole patches
  // On a CPU the loops of an invocation are limited to 65,535 iterations in all (Mesa 22.3). An evaluation of n elements takes
  // n / 8 * 5 / 4 iterations, and the weights of a level as many as 11 evaluations.
  const auto evaluations = static_cast<uint32_t>(options.iterations) + 12;
  // iterate.comp uses one workgroup per pair. Larger levels are spread over a GPU, with two dispatches per step. On an H200
  // that is faster for one pair of 200 features (0.5 ms instead of 0.8) and for 16 pairs (0.04 ms per pair instead of 0.06).
  // Only the features of the plan decide, so that results do not depend on the size of a batch.
  fused_elements = cpu ? std::min(16384u, 65535u * 8 * 4 / 5 / evaluations) : 4096u;
}

uint32_t shader_format(PixelFormat format) {
  switch (format) {
    case PixelFormat::r8: return ICLK_FORMAT_R8;
    case PixelFormat::bgra8: return ICLK_FORMAT_BGRA8;
    case PixelFormat::r32f: return ICLK_FORMAT_R32F;
    case PixelFormat::rgba32f: return ICLK_FORMAT_RGBA32F;
    default: return ICLK_FORMAT_RGBA8;
  }
}

VkFormat texel_format(PixelFormat format) {
  switch (format) {
    case PixelFormat::r8: return VK_FORMAT_R8_UNORM;
    case PixelFormat::r32f: return VK_FORMAT_R32_SFLOAT;
    case PixelFormat::rgba32f: return VK_FORMAT_R32G32B32A32_SFLOAT;
    default: return VK_FORMAT_R8G8B8A8_UNORM;  // also for BGRA, which not every device has: shaders swap the channels
  }
}

}  // namespace iclk::internal
