#pragma once
#include <memory>

#include <iclk/align/network/convolution.h>

namespace iclk::internal {

/// The end of an encoder's level on a device: the map, which is the mean over the channels of what the last layer gives, and
/// 2x2 means of each channel, which are the next level's input.
class FeatureMaps {
 public:
  explicit FeatureMaps(std::shared_ptr<const engine::Context> context);

  /// Of what `last`, which does not write_map(), has left in `made`. A reduced step has made the means; those of any other go
  /// to `next`.
  void record(engine::Recorder& recorder, const ConvStep& last, const engine::Buffer& made, const engine::Buffer& next,
              const MapPlace& place, const MapPart& part) const;
  /// Room for `sources` buffers of maps.
  void add_to(engine::ArenaSize& size, uint32_t sources) const;

 private:
  engine::Kernel whole_, sums_[2];  // [1]: of whole vec4
};

}  // namespace iclk::internal
