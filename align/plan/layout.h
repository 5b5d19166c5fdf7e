#pragma once
#include <algorithm>
#include <array>
#include <vector>

#include <iclk/align/model.h>
#include <iclk/align/plan/cells.h>
#include <iclk/engine/context.h>
#include <iclk/shaders/shared.h>

namespace iclk::internal {

/// The positions of all data of a plan in the device's buffers. Pure arithmetic, no device.
struct Layout {
  /// With a model its encoder makes the maps, including level 0. `storage_reads`: Context::storage_reads().
  Layout(const Plan& plan, const AlignerOptions& options, const Model* model = nullptr, bool storage_reads = false);

  std::vector<shaders::LevelInfo> levels;  // finest first
  uint32_t blocks_x = 0, blocks_y = 0;     // 8x8 blocks that cover an image
  uint32_t pixel_words = 0;                // 32-bit words of an image's raw pixels
  uint32_t map_stride = 0;                 // floats of an image's maps
  bool learned = false;                    // an encoder makes the maps
  bool weighted = false;                   // elements have weights
  bool level0_in_pixels = false;           // there is no map of level 0: kernels read the raw pixels through a texel view
  uint32_t element_stride = 0;             // elements of a reference's template, all levels
  uint32_t weight_stride = 0;              // elements of the largest level, rounded up to whole blocks of weights
  uint32_t trace_stride = 0;               // entries of a pair
  uint32_t tile_stride = 0;                // mask tiles of a reference, all levels, at most
  uint32_t entry_stride = 0;               // their entries
  uint32_t most_entries = 0;               // of a level
  uint32_t match_places = 0;               // of a target, for the search by matching

  /// The number of elements of the largest level.
  uint32_t most_elements() const {
    uint32_t most = 0;
    for (const shaders::LevelInfo& level : levels) most = std::max(most, level.element_count);
    return most;
  }
  uint32_t row_pixels() const { return blocks_x * ICLK_BLOCK; }
  /// Texels from one image to the next in the buffer of this level.
  uint32_t level_stride(int level) const {
    return level == 0 && level0_in_pixels ? row_pixels() * levels[0].height : map_stride;
  }
};

/// The 8x8 blocks of a level that patches can reach. They begin one block before the image, because patches extend beyond its
/// border.
struct BlockLattice {
  uint32_t columns, rows;
};
BlockLattice lattice(const shaders::LevelInfo& level);

/// Blocks of that lattice, [x0, x1] x [y0, y1].
struct BlockRange {
  uint32_t x0, x1, y0, y1;
  uint32_t count() const { return (x1 + 1 - x0) * (y1 + 1 - y0); }
};
/// The blocks that the patch of a feature in a cell can reach (align/device/tiles.cpp).
BlockRange blocks_of(const Cells::Rectangle& cell, size_t level);

/// The ICLK_FORMAT_... constant of a plan's pixel format.
uint32_t shader_format(PixelFormat format);
/// The format of a texel buffer with one texel per pixel of the plan.
VkFormat texel_format(PixelFormat format);

/// The number of pairs in one batch on a device: at most plan.max_pairs, and no buffer may exceed its limit.
/// Throws Error(unsupported) with the numbers if not even one pair fits.
int pairs_per_batch(const Plan& plan, const Layout& layout, const VkPhysicalDeviceLimits& limits);

/// Workgroup sizes for a type of device: a CPU runs one SIMD vector at a time, and each inactive lane costs time. Powers of
/// two, within the limits of the device.
struct WorkgroupSizes {
  WorkgroupSizes(const engine::DeviceInfo& device, const AlignerOptions& options);
  uint32_t iterate;         // sums with a reduction
  uint32_t map;             // one invocation per pixel, block or element
  uint32_t weights;         // one workgroup per pair
  uint32_t group_elements;  // normal_equations: elements per workgroup
  uint32_t fused_elements;  // iterate.comp processes levels of up to this many elements
};

}  // namespace iclk::internal
