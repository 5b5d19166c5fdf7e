#pragma once
#include <compare>

#include <iclk/engine/device_ranking.h>

namespace iclk::internal {

/// Ways to compute a 3x3 convolution. They give the same result up to rounding, but differ in time and memory.
enum class ConvVariant {
  direct,       ///< register tile; the fewest bytes
  winograd4,    ///< F(4x4, 3x3): 36 products for 16 pixels instead of 144
  winograd4x1,  ///< F(4x1, 3x3): 18 products for 4 pixels instead of 36, in a register tile like `direct`
};
constexpr ConvVariant kConvVariants[] = {ConvVariant::direct, ConvVariant::winograd4, ConvVariant::winograd4x1};
const char* name(ConvVariant variant);

/// A layer of an encoder and the size in pixels at which it runs. The time of the last layer of a level includes the map and
/// the means that follow from its output.
struct ConvShape {
  int in = 0, out = 0, dilation = 1, width = 0, height = 0;
  bool last = false;
  auto operator<=>(const ConvShape&) const = default;
};

/// Chooses a variant. On CPUs it follows a rule from measurements on lavapipe, within a few percent of the fastest variant
/// there. On all other devices it is `direct`, the fastest on every measured GPU; it needs the fewest registers and no scratch
/// memory.
ConvVariant choose_variant(const ConvShape& shape, engine::DeviceType type);

}  // namespace iclk::internal
