#pragma once
#include <functional>
#include <memory>
#include <vector>

#include <iclk/align/model.h>
#include <iclk/align/network/conv_variant.h>
#include <iclk/engine/context.h>

namespace iclk::internal {

/// Layers that a device computes of `levels` levels of a model's encoder at an image size, each once: those of a tile where
/// the image is cut. Throws Error(unsupported) for an image that cannot be cut small enough.
std::vector<ConvShape> encoder_shapes(const Model& model, int width, int height, int levels);

/// What a layer of an image costs in each variant, seconds: of processor time on a device that is a CPU, else by the clock of
/// the device, or where it has none the wall's.
struct LayerTimes {
  struct Way {
    ConvVariant variant;
    double median, least;
  };
  ConvShape shape;
  std::vector<Way> ways;  ///< every variant that the device has a kernel for; `direct` is one

  const Way& fastest() const;                 ///< by its least time
  const Way* way(ConvVariant variant) const;  ///< null where there is no kernel
};
/// Measures layers on the device, every variant that it has a kernel for `repetitions` times in turns.
/// Memory: input and output of one layer, transformed tiles of every variant. `progress` is called before each layer with its
/// number and how many there are. Throws what the device throws. Precondition: repetitions > 0.
std::vector<LayerTimes> time_layers(const std::shared_ptr<const engine::Context>& context, const std::vector<ConvShape>& shapes,
                                    int repetitions, const std::function<void(int layer, int layers)>& progress);

}  // namespace iclk::internal
