#pragma once
#include <memory>

#include <iclk/align/network/convolution.h>

namespace iclk::internal {

/// The last step of an encoder's level on a device. It computes the map: the mean over the channels of the last layer. It also
/// computes the input of the next level: 2x2 means of each channel.
class FeatureMaps {
 public:
  explicit FeatureMaps(std::shared_ptr<const engine::Context> context);

  /// Computes the map from the output `made` of the step `last`, and the means into `next` unless the step is reduced. A
  /// reduced step has already computed the means. Precondition: not writes_map(last).
  void record(engine::Recorder& recorder, const ConvStep& last, const engine::Buffer& made, const engine::Buffer& next,
              const MapPlace& place, const MapPart& part) const;
  /// Room for `sources` buffers of maps.
  void add_to(engine::ArenaSize& size, uint32_t sources) const;

 private:
  engine::Kernel whole_, sums_[2];  // [1]: writes whole vec4
};

}  // namespace iclk::internal
