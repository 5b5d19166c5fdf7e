#pragma once
#include <cstddef>

#include <iclk/align/model.h>

namespace iclk::internal {

/// Limits of a model, far beyond useful ones. They bound the memory and time that a hostile file can cause.
constexpr int kMaxModelLevels = 12, kMaxLevelLayers = 16, kMaxChannels = 1024, kMaxDilation = 64;
constexpr size_t kMaxModelParameters = size_t{1} << 26;

/// Checks that the channels of successive layers match, from the input to the last level. The M-estimator must have four input
/// channels and one output. The numbers of weights must fit, and all values must be finite and within the limits. Throws
/// Error(invalid_argument) that names layer, value and requirement.
void check_model(const Model& model);

/// Checks that the options suit this model. Throws Error(invalid_argument).
void check_model_use(const Model& model, const AlignerOptions& options);

}  // namespace iclk::internal
