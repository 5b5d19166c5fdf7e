#pragma once
#include <memory>
#include <string>
#include <vector>

#include <iclk/align/network/layer_times.h>

#include "apps/eval/common/machine.h"
#include "apps/iclk/common/progress.h"

namespace iclk {

/// What each layer of a model's encoder costs in every variant of its convolution.
struct LayerReport {
  Machine machine;
  std::string model;
  int width = 0, height = 0, repetitions = 0;
  std::string clock;  ///< "processor" of a device that is a CPU, "device" of one that has a clock, else "wall"
  std::vector<internal::LayerTimes> layers;  ///< each shape once, finest level first
};

/// Precondition: repetitions > 0. Throws Error for a size that the encoder cannot cut small enough, or a failing device.
LayerReport run_layers(const std::shared_ptr<engine::Context>& context, const Model& model, int width, int height, int levels,
                       int repetitions, const Progress& progress);

nlohmann::ordered_json to_json(const LayerReport& report);
std::string to_table(const LayerReport& report);

}  // namespace iclk
