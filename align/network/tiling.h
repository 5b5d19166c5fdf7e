#pragma once
#include <vector>

#include <iclk/align/network/convolution.h>

namespace iclk::internal {

/// The largest buffer of activations in bytes. Vulkan guarantees this size, so images have the same tiles on all devices.
inline constexpr uint64_t kActivationBytes = 128ull << 20;

/// For each level of an encoder its input, then the outputs of its layers, for images of a size.
std::vector<std::vector<TensorLayout>> encoder_tensors(const Model& model, uint32_t width, uint32_t height, int levels);

/// The number of texels of the largest of these tensors, which fits all of them.
uint64_t most_texels(const std::vector<std::vector<TensorLayout>>& tensors);

/// The tiles of an image for an encoder. All tiles have one size, and each is encoded as a separate image. Only pixels of its
/// maps that are not affected by the tile's border are used. All in pixels of level 0. The tiles follow from size, model and
/// limit only, so an image has the same maps in every batch.
struct Tiling {
  /// A column or a row of tiles. The tile begins at `origin` and gives the maps of [begin, end), which are adjacent. The first
  /// tile begins and the last one ends at the border of the image. Each `end` but the last is a multiple of the pixel size of
  /// the coarsest level.
  struct Span {
    uint32_t origin, begin, end;
  };
  /// Uses one tile if `most_bytes` per buffer suffice, else the tiles with the fewest pixels to compute. Throws
  /// Error(unsupported) if no tile with the margins of `levels` levels fits.
  Tiling(const Model& model, uint32_t width, uint32_t height, int levels, uint64_t most_bytes = kActivationBytes);

  uint32_t width, height;  // of a tile
  std::vector<Span> columns, rows;
};

}  // namespace iclk::internal
