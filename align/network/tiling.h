#pragma once
#include <vector>

#include <iclk/align/network/convolution.h>

namespace iclk::internal {

/// A buffer of activations has at most so many bytes: what Vulkan promises of every device, so that images are cut alike on
/// all.
inline constexpr uint64_t kActivationBytes = 128ull << 20;

/// For each level of an encoder what goes into it, then what its layers give, for images of a size.
std::vector<std::vector<TensorLayout>> encoder_tensors(const Model& model, uint32_t width, uint32_t height, int levels);

/// Texels of the largest of these activations: no buffer of them needs more.
uint64_t most_texels(const std::vector<std::vector<TensorLayout>>& tensors);

/// How an image is cut for an encoder. A tile is encoded as an image of its own and is as large as the others; of its maps only
/// those pixels are taken that no wrong border reaches. All in pixels of level 0. Arithmetic only, and of size, model
/// and limit alone, so that an image has the same maps in every batch.
struct Tiling {
  /// A column or a row of tiles: they begin at `origin` and give the maps of [begin, end), which lie one after the other. The
  /// first tile begins and the last one ends where the image does, whose border is then theirs. All but the last `end`
  /// are multiples of the pixel of the coarsest level.
  struct Span {
    uint32_t origin, begin, end;
  };
  /// One tile if no more than `most_bytes` a buffer are needed, else the cut with the fewest pixels to compute.
  /// Throws Error(unsupported) if the margins that `levels` levels of the model need leave no tile so small.
  Tiling(const Model& model, uint32_t width, uint32_t height, int levels, uint64_t most_bytes = kActivationBytes);

  uint32_t width, height;  // of a tile
  std::vector<Span> columns, rows;
};

}  // namespace iclk::internal
