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
  winograd2,    ///< F(2x2, 3x3): 16 products for 4 pixels instead of 36
  winograd4,    ///< F(4x4, 3x3): 36 products for 16 pixels instead of 144
  winograd4x1,  ///< F(4x1, 3x3): 18 products for 4 pixels instead of 36, in a register tile as `direct` has
};
const char* name(ConvVariant variant);

/// A layer of an encoder at the size at which it is computed, pixels, and the precision of what goes in and out. The last layer
/// of a level is measured with what is made of its output.
struct ConvShape {
  int in = 0, out = 0, dilation = 1, width = 0, height = 0;
  Precision precision = Precision::fp32;
  bool last = false;
  auto operator<=>(const ConvShape&) const = default;
};

/// Which variant is the fastest for which layer on one device. Any choice is right to rounding; they differ in time and memory.
struct Tuning {
  std::map<ConvShape, ConvVariant> variants;

  /// What was measured, else the usual choice: Winograd F(4x4) where a layer has channels enough.
  ConvVariant choose(const ConvShape& shape) const;

  /// For a cache file: `key`, one line a layer, a checksum.
  std::string text(std::string_view key) const;
  /// Nothing if the text is not exactly what text(key) wrote: damaged, of another version, another device.
  static std::optional<Tuning> parse(std::string_view text, std::string_view key);
};

/// Names what measurements depend on: the device's UUID, the driver's version and the shaders. Of letters, digits and dashes.
std::string tuning_key(const engine::Context& context);

/// Layers that a device computes of `levels` levels of a model's encoder at an image size, each once: those of a tile where
/// the image is cut. Throws Error(unsupported) for an image that cannot be cut small enough.
std::vector<ConvShape> encoder_shapes(const Model& model, int width, int height, int levels,
                                      Precision precision = Precision::fp32);

/// What a layer of an image costs in each variant, seconds: of processor time on a device that is a CPU, else of wall time.
struct LayerTimes {
  struct Way {
    ConvVariant variant;
    double median, least;
  };
  ConvShape shape;
  std::vector<Way> ways;  ///< every variant

  const Way& fastest() const;  ///< by its least time
};
/// Measures layers on the device, every variant `repetitions` times in turns. Memory, `progress` and errors: see tune().
std::vector<LayerTimes> time_layers(const std::shared_ptr<const engine::Context>& context, const std::vector<ConvShape>& shapes,
                                    int repetitions, const std::function<void(int layer, int layers)>& progress = {});

/// Adds the layers that `known` lacks, by measuring every variant on the device: seconds on a CPU, and the memory of one layer.
/// `progress`, if given, is called before each layer with its number and how many there are. Throws Error(unsupported),
/// Error(out_of_memory), Error(device_lost).
Tuning tune(const std::shared_ptr<const engine::Context>& context, const std::vector<ConvShape>& shapes, Tuning known = {},
            const std::function<void(int layer, int layers)>& progress = {});

}  // namespace iclk
