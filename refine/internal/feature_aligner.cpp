#include <iclk/refine/internal/feature_aligner.h>

#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/align/device_aligner.h>
#include <iclk/engine/error.h>

namespace iclk::internal {

std::unique_ptr<FeatureAligner> make_feature_aligner(Aligner& aligner, const FeatureAlignmentOptions& options) {
  if (const auto* cpu = dynamic_cast<const CpuAligner*>(&aligner)) return make_cpu_feature_aligner(*cpu, options);
  if (const auto* device = dynamic_cast<const DeviceAligner*>(&aligner)) return make_device_feature_aligner(*device, options);
  throw Error(ErrorCode::unsupported, "no feature aligner for this kind of aligner");
}

}  // namespace iclk::internal
