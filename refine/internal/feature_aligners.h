#pragma once
#include <iclk/refine/feature_aligner.h>

namespace iclk {

class CpuAligner;
class DeviceAligner;

namespace internal {

/// The CPU reference: align_feature() for every feature, in the grey maps that `aligner` keeps, which must outlive it.
std::unique_ptr<FeatureAligner> make_cpu_feature_aligner(const CpuAligner& aligner, const FeatureAlignmentOptions& options);

/// shaders/refine/feature_alignment.comp on the grey maps of a DeviceAligner, one submission a call; the same contract, single
/// precision. `aligner` must outlive it. Memory is allocated here, for the aligner's plan; with a model also that of the grey
/// maps (GreyMaps). Throws Error(unsupported) if it does not fit.
std::unique_ptr<FeatureAligner> make_device_feature_aligner(const DeviceAligner& aligner,
                                                            const FeatureAlignmentOptions& options);

}  // namespace internal
}  // namespace iclk
