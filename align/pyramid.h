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

  /// Bilinear value at (u, v), clamped to the image. Preconditions: width, height >= 2, u and v finite.
  double bilinear(double u, double v) const;
  /// Whether one of the four pixels of that value is hidden. The same preconditions.
  bool hidden(double u, double v) const;
  /// Central differences with the border pixel repeated.
  double gradient_u(int u, int v) const;
  double gradient_v(int u, int v) const;
};

/// Finest first.
using Pyramid = std::vector<Map>;

/// A grey value is weights . (R, G, B).
using GreyWeights = std::array<float, 3>;
inline constexpr GreyWeights kLuma = {ICLK_LUMA_R, ICLK_LUMA_G, ICLK_LUMA_B};

/// Grey map of level 0: luma 0.299 R + 0.587 G + 0.114 B in [0, 1]; a single channel is taken as it is.
Map grey_map(const ImageView& image);

/// R, G and B of level 0 in [0, 1], in this order; a single channel is all three.
std::vector<Map> rgb_maps(const ImageView& image);

/// 2x2 means, sizes floored: the classical, unlearned features.
Pyramid grey_pyramid(const ImageView& image, int levels);
/// The same of three maps of one size, as rgb_maps() makes them, with other weights than luma's.
Pyramid grey_pyramid(std::span<const Map> rgb, const GreyWeights& weights, int levels);
Map half_size(const Map& map);

/// Value of a hidden pixel of a target's map. A mean of pixels of which one is hidden is larger than kHiddenFrom at any level.
inline constexpr float kHidden = ICLK_HIDDEN, kHiddenFrom = ICLK_HIDDEN_FROM;
/// Hides every pixel of a pyramid under which the mask (Pair::target_mask, of level 0's size) is 0 somewhere.
void hide(Pyramid& pyramid, const ImageView& mask);
/// The same where another pyramid of the same sizes is hidden.
void hide(Pyramid& pyramid, const Pyramid& like);

/// Finest levels of the grey pyramid that feature alignment works on, whatever the maps that were aligned.
inline constexpr int kFeatureAlignmentLevels = 2;

}  // namespace iclk
