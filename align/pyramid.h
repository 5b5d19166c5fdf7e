#pragma once
#include <array>
#include <cmath>
#include <span>
#include <vector>

#include <iclk/align/image.h>
#include <iclk/shaders/shared.h>

namespace iclk {

/// One level of a feature pyramid on the host: width x height floats, row-major.
struct Map {
  int width = 0, height = 0;
  std::vector<float> data;

  Map() = default;
  Map(int w, int h) : width(w), height(h), data(static_cast<size_t>(w) * h) {}
  float& at(int u, int v) { return data[static_cast<size_t>(v) * width + u]; }
  float at(int u, int v) const { return data[static_cast<size_t>(v) * width + u]; }

  /// The bilinear value at (u, v), clamped to the image. Preconditions: width, height >= 2; u and v finite.
  double bilinear(double u, double v) const;
  /// Whether bilinear() would read a hidden pixel. The same preconditions.
  bool hidden(double u, double v) const;
  /// Central differences; border pixels are repeated.
  double gradient_u(int u, int v) const;
  double gradient_v(int u, int v) const;
};

/// The levels of an image, finest first.
using Pyramid = std::vector<Map>;

/// A grey value is weights . (R, G, B).
using GreyWeights = std::array<float, 3>;
inline constexpr GreyWeights kLuma = {ICLK_LUMA_R, ICLK_LUMA_G, ICLK_LUMA_B};

/// The grey map of level 0: luma 0.299 R + 0.587 G + 0.114 B in [0, 1]; a single channel is used unchanged.
Map grey_map(const ImageView& image);

/// The R, G and B maps of level 0 in [0, 1], in this order; a single channel gives three equal maps.
std::vector<Map> rgb_maps(const ImageView& image);

/// The classical, unlearned features: 2x2 means, sizes floored.
Pyramid grey_pyramid(const ImageView& image, int levels);
/// The grey pyramid with other weights than luma, from the three maps of rgb_maps().
Pyramid grey_pyramid(std::span<const Map> rgb, const GreyWeights& weights, int levels);
Map half_size(const Map& map);

/// The value of hidden pixels in the maps of a target. At every level, means that include one are larger than kHiddenFrom.
inline constexpr float kHidden = ICLK_HIDDEN, kHiddenFrom = ICLK_HIDDEN_FROM;
/// Hides the pixels of a pyramid that cover a 0 of the mask (Pair::target_mask, of the size of level 0).
void hide(Pyramid& pyramid, const ImageView& mask);
/// grey_map(), with these pixels hidden.
Map visible_map(const ImageView& image, const ImageView& mask);
/// Hides the pixels that are hidden in another pyramid of the same sizes.
void hide(Pyramid& pyramid, const Pyramid& like);

/// The number of finest levels of the grey pyramid that feature alignment uses, whichever maps the aligner used.
inline constexpr int kFeatureAlignmentLevels = 2;

}  // namespace iclk
