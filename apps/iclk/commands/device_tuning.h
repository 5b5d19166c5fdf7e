#pragma once
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <iclk/align/network/layer_times.h>

#include "apps/iclk/common/measure.h"

namespace iclk {

/// What `iclk devices --tune` measures: every layer of these encoders at these sizes.
struct TuningWish {
  std::vector<std::shared_ptr<const Model>> models;
  std::vector<std::pair<int, int>> sizes;  ///< of images, pixels
};

struct TuningReport {
  /// Seconds of the layers of an image, each once: of processor time where the device is a CPU, else of the device's, or the
  /// wall's where it has no clock.
  struct Encoder {
    std::string model;
    int width = 0, height = 0;
    double usual = 0;  ///< in usual_variant(); NaN where the device cannot run one of them
    double tuned = 0;  ///< in the fastest variants
  };
  std::string device, file;
  int layers = 0;  ///< measured
  std::vector<Encoder> encoders;
  std::vector<LayerTimes::Dropped> dropped;  ///< variants that some layer was measured without, each with its first reason
};

/// Measures and writes the cache file of the device in `folder`, which keeps what it holds of other layers. Throws Error(io)
/// before anything is measured where the folder cannot be written, Error(unsupported) for a size that cannot be cut small
/// enough, and what time_layers() throws; then the file stays as it was.
TuningReport tune_device(const std::shared_ptr<const engine::Context>& context, const TuningWish& wish,
                         const std::string& folder, const Progress& progress);

nlohmann::ordered_json to_json(const TuningReport& report);
std::string to_table(const TuningReport& report);

}  // namespace iclk
