#pragma once
#include <functional>
#include <memory>
#include <vector>

#include <iclk/align/model.h>
#include <iclk/align/network/conv_variant.h>
#include <iclk/engine/context.h>

namespace iclk::internal {

/// The different layers of the `levels` finest levels of a model's encoder, at an image size; the layers of a tile if the image
/// is tiled. Throws Error(unsupported) for an image that cannot be tiled.
std::vector<ConvShape> encoder_shapes(const Model& model, int width, int height, int levels);

/// The time of a layer of one image in each variant, in seconds: processor time on a CPU device, else device time, or wall
/// time if the device has no timestamps.
struct LayerTimes {
  struct Way {
    ConvVariant variant;
    double median, least;
  };
  ConvShape shape;
  std::vector<Way> ways;  ///< every variant with a kernel on the device; includes `direct`

  const Way& fastest() const;                 ///< by its least time
  const Way* way(ConvVariant variant) const;  ///< null: no kernel
};
/// Measures layers on the device. All variants with a kernel run `repetitions` times, in turn. It needs memory for input and
/// output of one layer and the transformed tiles of every variant. `progress` is called before each layer with its number and
/// the number of layers. Throws the errors of the device. Precondition: repetitions > 0.
std::vector<LayerTimes> time_layers(const std::shared_ptr<const engine::Context>& context, const std::vector<ConvShape>& shapes,
                                    int repetitions, const std::function<void(int layer, int layers)>& progress);

}  // namespace iclk::internal
