#pragma once
#include <compare>

#include <iclk/engine/device_ranking.h>

namespace iclk::internal {

/// Ways to compute the same 3x3 convolution. Any is right to rounding; they differ in time and memory.
enum class ConvVariant {
  direct,       ///< register tile; the fewest bytes
  winograd4,    ///< F(4x4, 3x3): 36 products for 16 pixels instead of 144
  winograd4x1,  ///< F(4x1, 3x3): 18 products for 4 pixels instead of 36, in a register tile as `direct` has
};
constexpr ConvVariant kConvVariants[] = {ConvVariant::direct, ConvVariant::winograd4, ConvVariant::winograd4x1};
const char* name(ConvVariant variant);

/// A layer of an encoder at the size at which it is computed, pixels. The last layer of a level is measured with what is made
/// of its output.
struct ConvShape {
  int in = 0, out = 0, dilation = 1, width = 0, height = 0;
  bool last = false;
  auto operator<=>(const ConvShape&) const = default;
};

/// On a CPU by a rule that was found by measuring lavapipe, which is within a few percent of the fastest there; on any other
/// device `direct`, which was the fastest on every GPU measured, and needs the fewest registers and no scratch memory.
ConvVariant choose_variant(const ConvShape& shape, engine::DeviceType type);

}  // namespace iclk::internal
