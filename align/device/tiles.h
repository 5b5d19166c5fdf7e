#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include <iclk/align/features.h>
#include <iclk/align/plan/layout.h>

namespace iclk::internal {

/// Lists, for the mask kernel, the features whose patches reach each 8x8 block of each level (shaders::MaskTile). Time and
/// space are proportional to the number of features. After the constructor it allocates nothing.
class TileLists {
 public:
  TileLists(const Plan& plan, const Layout& layout);

  /// Writes at most Layout::tile_stride tiles and Layout::entry_stride entries, in order, and returns the number of tiles.
  /// Unusable features are left out. Positions have single precision, as in the kernel.
  uint32_t build(const Features& features, std::span<const FeatureCheck> checks, shaders::MaskTile* tiles, uint32_t* entries);
  /// The same for features that are not known yet, one in each cell: its patch may reach all these blocks.
  uint32_t build(const Cells& cells, shaders::MaskTile* tiles, uint32_t* entries);

 private:
  template <class BlocksOf>
  uint32_t build(uint32_t features, const BlocksOf& blocks_of, shaders::MaskTile* tiles, uint32_t* entries);

  const Layout& layout_;
  std::vector<uint32_t> tile_of_block_;   // 1 + the tile of the block in this level; 0: none yet
  std::vector<shaders::MaskTile> tiles_;  // of a level
  std::vector<uint32_t> blocks_;          // their blocks
  std::vector<uint32_t> entries_;         // of a level
};

}  // namespace iclk::internal
