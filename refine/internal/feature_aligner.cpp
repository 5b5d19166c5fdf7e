#include <iclk/refine/internal/feature_aligner.h>

#include <string>

#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/align/device_aligner.h>
#include <iclk/engine/error.h>

namespace iclk::internal {

void check(const FeatureAlignmentTask& task, int references, int pairs) {
  const auto in_plan = [](const char* what, int index, int count) {
    if (index < 0 || index >= count)
      throw Error(ErrorCode::invalid_argument,
                  std::string("feature alignment: ") + what + " " + std::to_string(index) + " is outside the plan");
  };
  in_plan("slot", task.reference, references);
  in_plan("pair", task.pair, pairs);
  in_plan("level", task.level, kFeatureAlignmentLevels);
}

std::unique_ptr<FeatureAligner> make_feature_aligner(Aligner& aligner, const FeatureAlignmentOptions& options) {
  if (const auto* cpu = dynamic_cast<const CpuAligner*>(&aligner)) return make_cpu_feature_aligner(*cpu, options);
  if (const auto* device = dynamic_cast<const DeviceAligner*>(&aligner)) return make_device_feature_aligner(*device, options);
  throw Error(ErrorCode::unsupported, "no feature aligner for this kind of aligner");
}

}  // namespace iclk::internal
