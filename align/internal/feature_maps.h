#pragma once
#include <memory>

#include <iclk/align/internal/convolution.h>

namespace iclk::internal {

/// The end of an encoder's level on a device: the map, which is the mean over the channels of what the last layer gives, and
/// 2x2 means of each channel, which are the next level's input.
class FeatureMaps {
 public:
  FeatureMaps(std::shared_ptr<const engine::Context> context, Precision precision);

  /// The pixels [first, end) of a level that have a map, and where it lies. Floats. What a row has beyond, up to a multiple
  /// of four floats, is overwritten if `end_u` is the step's width.
  struct Target {
    const engine::Buffer* maps;
    uint32_t offset, pitch, stride;  // of pixel (0, 0), from row to row, from image to image
    uint32_t first_image;
    uint32_t first_u, first_v, end_u, end_v;
  };
  /// Of images at .. at + count - 1 of what `last` has left in `made`. A reduced step has made the means; those of any other
  /// go to `next`.
  void record(engine::Recorder& recorder, const ConvStep& last, uint32_t at, uint32_t count, const engine::Buffer& made,
              const engine::Buffer& next, const Target& target) const;
  /// Room for `sources` buffers of maps.
  void add_to(engine::ArenaSize& size, uint32_t sources) const;

 private:
  Precision precision_;
  engine::Kernel whole_, sums_[2];  // [1]: of whole vec4
};

}  // namespace iclk::internal
