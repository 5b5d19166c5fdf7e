#pragma once
#include <cstddef>

#include <iclk/align/model.h>

namespace iclk::internal {

/// What a model may be at most. Far beyond any that is useful; they bound what a hostile file can ask for.
constexpr int kMaxModelLevels = 12, kMaxLevelLayers = 16, kMaxChannels = 1024, kMaxDilation = 64;
constexpr size_t kMaxModelParameters = size_t{1} << 26;

/// That the layers fit together: channels in a chain from the input to the last level, four into the M-estimator and one out,
/// as many weights as the channels ask for, all finite, nothing beyond the limits. Throws Error(invalid_argument) that names
/// layer, value and what it must be.
void check_model(const Model& model);

/// That the options can be met with this model. Throws Error(invalid_argument).
void check_model_use(const Model& model, const AlignerOptions& options);

}  // namespace iclk::internal
