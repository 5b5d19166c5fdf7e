#pragma once
#include <compare>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <iclk/align/model.h>
#include <iclk/engine/context.h>

namespace iclk {

/// Ways to compute the same 3x3 convolution.
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

/// What is taken where nothing was measured. On a CPU a rule that was found by measuring lavapipe, which is within a few
/// percent of the fastest there; on any other device `direct`, which needs the fewest registers and no scratch memory.
ConvVariant usual_variant(const ConvShape& shape, engine::DeviceType type);

/// Which variant is the fastest for which layer on one device. Any choice is right to rounding; they differ in time and memory.
struct Tuning {
  std::map<ConvShape, ConvVariant> variants;

  /// What was measured, else usual_variant() of the device.
  ConvVariant choose(const ConvShape& shape, engine::DeviceType type) const;

  /// For a cache file: `key`, one line a layer, a checksum.
  std::string text(std::string_view key) const;
  /// Nothing if the text is not exactly what text(key) wrote: damaged, of another version, another device.
  static std::optional<Tuning> parse(std::string_view text, std::string_view key);
};

/// Names what measurements depend on: the device's UUID, the driver's version and the shaders. Of letters, digits and dashes.
std::string tuning_key(const engine::Context& context);

/// Layers that a device computes of `levels` levels of a model's encoder at an image size, each once: those of a tile where
/// the image is cut. Throws Error(unsupported) for an image that cannot be cut small enough.
std::vector<ConvShape> encoder_shapes(const Model& model, int width, int height, int levels);

/// Adds the layers that `known` lacks, as time_layers() measures them: seconds on a CPU. No aligner does so by itself, as
/// variants round differently and two runs must give the same bits.
Tuning tune(const std::shared_ptr<const engine::Context>& context, const std::vector<ConvShape>& shapes, Tuning known = {},
            const std::function<void(int layer, int layers)>& progress = {});

}  // namespace iclk
