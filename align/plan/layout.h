#pragma once
#include <algorithm>
#include <array>
#include <vector>

#include <iclk/align/plan/cells.h>
#include <iclk/align/model.h>
#include <iclk/engine/context.h>
#include <iclk/shaders/shared.h>

namespace iclk::internal {

/// Where everything of a plan lies in the device's buffers. Pure arithmetic, no device.
struct Layout {
  /// With a model the maps come from its encoder, and level 0 is one of them. `storage_reads`: Context::storage_reads().
  Layout(const Plan& plan, const AlignerOptions& options, const Model* model = nullptr, bool storage_reads = false);

  std::vector<shaders::LevelInfo> levels;  // finest first
  uint32_t blocks_x = 0, blocks_y = 0;     // 8x8 blocks that cover an image
  uint32_t pixel_words = 0;                // 32-bit words of an image's raw pixels
  uint32_t map_stride = 0;                 // floats of an image's maps
  bool learned = false;                    // maps are an encoder's
  bool weighted = false;                   // elements have weights of their own
  bool level0_in_pixels = false;           // level 0 is no map: kernels read the raw pixels through a texel view
  uint32_t element_stride = 0;             // elements of a reference's template, all levels
  uint32_t weight_stride = 0;              // elements of the level that has most, in whole blocks of weights
  uint32_t trace_stride = 0;               // entries of a pair
  uint32_t tile_stride = 0;                // mask tiles of a reference at most, all levels
  uint32_t entry_stride = 0;               // their entries
  uint32_t most_entries = 0;               // of a level
  uint32_t match_places = 0;               // of a target, where starts are matched

  /// Of the level that has most.
  uint32_t most_elements() const {
    uint32_t most = 0;
    for (const shaders::LevelInfo& level : levels) most = std::max(most, level.element_count);
    return most;
  }
  uint32_t row_pixels() const { return blocks_x * ICLK_BLOCK; }
  /// Texels from an image to the next, in the buffer that holds this level.
  uint32_t level_stride(int level) const {
    return level == 0 && level0_in_pixels ? row_pixels() * levels[0].height : map_stride;
  }
};

/// The 8x8 blocks of a level that patches can reach into: from the one before the image, as patches hang over its border.
struct BlockLattice {
  uint32_t columns, rows;
};
BlockLattice lattice(const shaders::LevelInfo& level);

/// Blocks of that lattice, [x0, x1] x [y0, y1].
struct BlockRange {
  uint32_t x0, x1, y0, y1;
  uint32_t count() const { return (x1 + 1 - x0) * (y1 + 1 - y0); }
};
/// Those that the patch of a feature within a cell may reach into (align/device/tiles.cpp).
BlockRange blocks_of(const Cells::Rectangle& cell, size_t level);

/// ICLK_FORMAT_* of a plan's pixel format.
uint32_t shader_format(PixelFormat format);
/// Of a texel buffer of a plan's pixels, a texel each.
VkFormat texel_format(PixelFormat format);

/// How many pairs of a plan one batch can hold on a device: as many as its largest buffer may have, at most plan.max_pairs.
/// Throws Error(unsupported) with the numbers if not even one fits.
int pairs_per_batch(const Plan& plan, const Layout& layout, const VkPhysicalDeviceLimits& limits);

/// Invocations a workgroup by what the device is: a CPU runs one SIMD vector at a time and pays for every masked lane. Powers
/// of two, and never more than the device has.
struct WorkgroupSizes {
  WorkgroupSizes(const engine::DeviceInfo& device, const AlignerOptions& options);
  uint32_t iterate;         // sums with a reduction
  uint32_t map;             // one invocation a pixel, block or element
  uint32_t weights;         // one workgroup a pair
  uint32_t group_elements;  // normal_equations: elements a workgroup
  uint32_t fused_elements;  // iterate.comp serves levels of up to so many elements
};

}  // namespace iclk::internal
