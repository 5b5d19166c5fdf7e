#include <iclk/align/device/tiles.h>

#include <algorithm>
#include <cmath>

namespace iclk::internal {
namespace {

float scale_of(size_t level) { return static_cast<float>(std::ldexp(1.0, -static_cast<int>(level))); }

BlockRange blocks_of(const Eigen::Vector2d& uv, size_t level) {
  const auto first = [scale = scale_of(level)](double x) {
    const float c = (static_cast<float>(x) + 0.5f) * scale - 0.5f;
    return static_cast<uint32_t>(static_cast<int>(std::floor(c)) - ICLK_PATCH_BEFORE + ICLK_BLOCK);
  };
  const uint32_t u = first(uv.x()), v = first(uv.y());
  return {u / ICLK_BLOCK, (u + ICLK_PATCH - 1) / ICLK_BLOCK, v / ICLK_BLOCK, (v + ICLK_PATCH - 1) / ICLK_BLOCK};
}

}  // namespace

BlockRange blocks_of(const Cells::Rectangle& cell, size_t level) {
  const BlockRange first = blocks_of(Eigen::Vector2d(cell.u0, cell.v0), level);
  const BlockRange last = blocks_of(Eigen::Vector2d(cell.u1 - 1, cell.v1 - 1), level);
  return {first.x0, last.x1, first.y0, last.y1};
}

TileLists::TileLists(const Plan& plan, const Layout& layout) : layout_(layout) {
  if (plan.dense) return;
  const auto [columns, rows] = lattice(layout.levels[0]);
  tile_of_block_.assign(static_cast<size_t>(columns) * rows, 0);
  tiles_.reserve(layout.tile_stride);
  blocks_.reserve(layout.tile_stride);
  entries_.resize(layout.most_entries);
}

uint32_t TileLists::build(const Features& features, std::span<const FeatureCheck> checks, shaders::MaskTile* tiles,
                          uint32_t* entries) {
  constexpr BlockRange none{1, 0, 1, 0};
  const auto blocks = [&](uint32_t i, size_t level) {
    return checks[i] == FeatureCheck::ok ? blocks_of(features.uv[i], level) : none;
  };
  return build(static_cast<uint32_t>(checks.size()), blocks, tiles, entries);
}

uint32_t TileLists::build(const Cells& cells, shaders::MaskTile* tiles, uint32_t* entries) {
  return build(
      cells.count(), [&](uint32_t i, size_t level) { return blocks_of(cells[i], level); }, tiles, entries);
}

template <class BlocksOf>
uint32_t TileLists::build(uint32_t features, const BlocksOf& blocks_of_feature, shaders::MaskTile* tiles, uint32_t* entries) {
  uint32_t tile_count = 0, entry_count = 0;
  for (size_t level = 0; level < layout_.levels.size(); ++level) {
    const uint32_t columns = lattice(layout_.levels[level]).columns;
    const auto for_each = [&](auto&& visit) {
      for (uint32_t i = 0; i < features; ++i) {
        const BlockRange b = blocks_of_feature(i, level);
        for (uint32_t y = b.y0; y <= b.y1; ++y)
          for (uint32_t x = b.x0; x <= b.x1; ++x) visit(i, x, y);
      }
    };
    tiles_.clear();
    blocks_.clear();
    for_each([&](uint32_t, uint32_t x, uint32_t y) {
      uint32_t& tile = tile_of_block_[y * columns + x];
      if (tile == 0) {
        tiles_.push_back({x | y << 16, static_cast<uint32_t>(level), 0, 0});
        blocks_.push_back(y * columns + x);
        tile = static_cast<uint32_t>(tiles_.size());
      }
      ++tiles_[tile - 1].count;
    });
    const uint32_t first_entry = entry_count;
    for (shaders::MaskTile& tile : tiles_) {
      tile.first = entry_count;
      entry_count += tile.count;
      tile.count = 0;
    }
    for_each([&](uint32_t feature, uint32_t x, uint32_t y) {
      shaders::MaskTile& tile = tiles_[tile_of_block_[y * columns + x] - 1];
      entries_[tile.first + tile.count++ - first_entry] = feature;
    });
    for (uint32_t block : blocks_) tile_of_block_[block] = 0;
    std::copy(tiles_.begin(), tiles_.end(), tiles + tile_count);
    std::copy_n(entries_.begin(), entry_count - first_entry, entries + first_entry);
    tile_count += static_cast<uint32_t>(tiles_.size());
  }
  return tile_count;
}

}  // namespace iclk::internal
