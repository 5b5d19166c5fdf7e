#pragma once
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <iclk/align/tuning.h>

namespace iclk {

/// What a layer of an image costs in each variant, seconds: of processor time on a device that is a CPU, else by the clock of
/// the device, or where it has none the wall's.
struct LayerTimes {
  struct Way {
    ConvVariant variant;
    double median, least;
  };
  struct Dropped {
    ConvVariant variant;
    std::string why;
  };
  ConvShape shape;
  std::vector<Way> ways;         ///< every variant that the device can run; one at least
  std::vector<Dropped> dropped;  ///< the others

  const Way& fastest() const;                 ///< by its least time
  const Way* way(ConvVariant variant) const;  ///< null where it was dropped
};
/// Measures layers on the device, every variant `repetitions` times in turns. One whose kernels cannot be built or run
/// (Error(unsupported), Error(vulkan), Error(out_of_memory)) is dropped. Memory: input and output of one layer, transformed
/// tiles of every variant. `progress`, if given, is called before each layer with its number and how many there are. Throws
/// Error(device_lost), and the first error where no variant is left. Precondition: repetitions > 0.
std::vector<LayerTimes> time_layers(const std::shared_ptr<const engine::Context>& context, const std::vector<ConvShape>& shapes,
                                    int repetitions, const std::function<void(int layer, int layers)>& progress = {});

/// Repetitions that a choice needs, of which the least counts.
constexpr int kTuningRuns = 5;

}  // namespace iclk
