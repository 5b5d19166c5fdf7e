#include <iclk/align/network/tiling.h>

#include <algorithm>
#include <string>

#include <iclk/engine/error.h>

namespace iclk::internal {
namespace {

// How far the outside of a border affects the maps, at most over all levels. Rounded up to pixels of the coarsest level (`grid`
// pixels of level 0).
uint32_t margin_of(const Model& model, int levels, uint32_t grid) {
  uint64_t reach = 0, margin = 0;
  for (int l = 0; l < levels; ++l) {
    reach = (reach + 1) / 2;  // a mean is affected if one of its pixels is
    for (const ConvLayer& layer : model.encoder[static_cast<size_t>(l)]) reach += static_cast<uint64_t>(layer.dilation);
    margin = std::max(margin, reach << l);
  }
  return static_cast<uint32_t>((margin + grid - 1) / grid * grid);
}

// One axis of the image. The length of tiles equals that of the image modulo `grid`, so that the last tile also begins on the
// grid.
struct Axis {
  uint32_t size, grid, margin;

  // The largest number of tiles, each one step of the grid after the previous one.
  uint32_t most_tiles() const { return std::max(1u, size / grid - std::min(size, 2 * margin) / grid); }
  // The length of each of `tiles` tiles.
  uint32_t length(uint32_t tiles) const {
    if (tiles == 1) return size;
    return 2 * margin + engine::groups_for(size / grid - 2 * margin / grid, tiles) * grid + size % grid;
  }
  // The smallest sum of their lengths.
  uint64_t pixels(uint32_t tiles) const { return size + (tiles - 1) * 2ull * margin; }
  std::vector<Tiling::Span> spans(uint32_t tiles) const {
    const uint32_t last = size - length(tiles), step = tiles > 1 ? length(tiles) - size % grid - 2 * margin : 0;
    std::vector<Tiling::Span> spans;
    for (uint32_t i = 0; i < tiles; ++i) {
      const uint32_t origin = std::min(i * step, last), next = std::min((i + 1) * step, last);
      spans.push_back({origin, i == 0 ? 0 : origin + margin, i + 1 == tiles ? size : next + margin});
    }
    return spans;
  }
};

}  // namespace

std::vector<std::vector<TensorLayout>> encoder_tensors(const Model& model, uint32_t width, uint32_t height, int levels) {
  std::vector<std::vector<TensorLayout>> tensors;
  TensorLayout now;
  now.channels = static_cast<uint32_t>(model.input_channels);
  for (int l = 0; l < levels; ++l) {
    const std::vector<ConvLayer>& layers = model.encoder[static_cast<size_t>(l)];
    now.width = width >> l;
    now.height = height >> l;
    now.border = 1;
    for (const ConvLayer& layer : layers) now.border = std::max(now.border, static_cast<uint32_t>(layer.dilation));
    tensors.push_back({now});
    for (const ConvLayer& layer : layers) {
      now.channels = static_cast<uint32_t>(layer.out);
      tensors.back().push_back(now);
    }
  }
  return tensors;
}

uint64_t most_texels(const std::vector<std::vector<TensorLayout>>& tensors) {
  uint64_t texels = 0;
  for (const auto& level : tensors)
    for (const TensorLayout& tensor : level) texels = std::max(texels, tensor.texels());
  return texels;
}

Tiling::Tiling(const Model& model, uint32_t image_width, uint32_t image_height, int levels, uint64_t most_bytes) {
  const uint32_t grid = 1u << (levels - 1), margin = margin_of(model, levels, grid);
  const Axis across{image_width, grid, margin}, down{image_height, grid, margin};
  const auto bytes = [&](uint32_t w, uint32_t h) { return kTexelBytes * most_texels(encoder_tensors(model, w, h, levels)); };
  uint64_t fewest = UINT64_MAX;
  uint32_t best_columns = 0, best_rows = 0;
  for (uint32_t m = 1; m <= across.most_tiles() && across.pixels(m) * image_height < fewest; ++m) {
    width = across.length(m);
    for (uint32_t n = 1; n <= down.most_tiles(); ++n) {
      height = down.length(n);
      if (bytes(width, height) > most_bytes) continue;
      const uint64_t pixels = static_cast<uint64_t>(m) * width * n * height;
      if (pixels < fewest) fewest = pixels, best_columns = m, best_rows = n;
      break;
    }
  }
  if (fewest == UINT64_MAX)
    throw Error(ErrorCode::unsupported,
                "activations of a " + std::to_string(image_width) + "x" + std::to_string(image_height) + " image need " +
                    std::to_string(bytes(image_width, image_height)) + " bytes, a buffer has " + std::to_string(most_bytes) +
                    ", and tiles with margins of " + std::to_string(margin) + " pixels, which " + std::to_string(levels) +
                    " levels of this model need, do not fit either; use fewer levels, a smaller model or the CPU solver");
  width = across.length(best_columns);
  height = down.length(best_rows);
  columns = across.spans(best_columns);
  rows = down.spans(best_rows);
}

}  // namespace iclk::internal
