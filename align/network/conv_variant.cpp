#include <iclk/align/network/conv_variant.h>

#include <cstdint>

namespace iclk::internal {

const char* name(ConvVariant variant) {
  constexpr const char* names[] = {"direct", "winograd4", "winograd4x1"};
  return names[static_cast<int>(variant)];
}

// The numbers are measurements on lavapipe (docs/results/convolutions.md). Whole tiles are transformed once per layer. That is
// faster if many products follow, and if there are enough tiles that threads need not repeat transformations.
ConvVariant choose_variant(const ConvShape& shape, engine::DeviceType type) {
  if (type != engine::DeviceType::cpu) return ConvVariant::direct;
  const int64_t in = shape.in, products = in * shape.out, input = in * shape.width * shape.height;
  return products >= 512 && input >= 50'000 ? ConvVariant::winograd4 : ConvVariant::winograd4x1;
}

}  // namespace iclk::internal
