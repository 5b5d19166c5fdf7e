#include <iclk/refine/feature_aligner.h>

#include <iclk/align/device_aligner.h>
#include <iclk/align/solver/cpu_aligner.h>
#include <iclk/engine/error.h>
#include <iclk/refine/internal/feature_aligners.h>

namespace iclk {

std::unique_ptr<FeatureAligner> make_feature_aligner(Aligner& aligner, const FeatureAlignmentOptions& options) {
  if (const auto* cpu = dynamic_cast<const CpuAligner*>(&aligner)) return internal::make_cpu_feature_aligner(*cpu, options);
  if (const auto* device = dynamic_cast<const DeviceAligner*>(&aligner))
    return internal::make_device_feature_aligner(*device, options);
  throw Error(ErrorCode::unsupported, "no feature aligner for this kind of aligner: give the refiner one");
}

}  // namespace iclk
