#pragma once
// The kernel of feature alignment, for DeviceFeatureAligner and DeviceRefiner.
#include <iclk/align/device/parts.h>
#include <iclk/engine/compute/kernel.h>
#include <iclk/refine/feature_alignment.h>
#include <iclk/shaders/refine/refine.h>
#include <iclk/shaders/shared.h>

namespace iclk::internal {

/// Bindings: levels, references, tasks, features, fine0, fine1, maps0, maps1, aligned. `level`: FeatureAlignmentTask::level.
engine::KernelDescription feature_alignment_kernel(uint32_t level = 0);
shaders::FeatureAlignmentPush feature_alignment_push(const FeatureAlignmentOptions& options, const DeviceMaps& maps);

/// Packs a feature for kernels. `ok`: its FeatureCheck is ok. An unknown depth sigma becomes 0.
shaders::FeatureInfo pack_feature(const Features& features, size_t index, bool ok);
AlignedFeature unpack_feature(const shaders::AlignedInfo& info);

}  // namespace iclk::internal
