#include <string>

#include <iclk/align/solver/cpu_aligner.h>
#include <iclk/engine/error.h>
#include <iclk/refine/internal/feature_aligners.h>

namespace iclk::internal {
namespace {

class CpuFeatureAligner final : public FeatureAligner {
 public:
  CpuFeatureAligner(const CpuAligner& aligner, const FeatureAlignmentOptions& options) : aligner_(aligner), options_(options) {
    options_.check();
  }

  std::vector<std::vector<AlignedFeature>> align(std::span<const FeatureAlignmentTask> tasks) override {
    std::vector<std::vector<AlignedFeature>> results;
    results.reserve(tasks.size());
    for (const FeatureAlignmentTask& task : tasks) {
      check("slot", task.reference, aligner_.plan().max_references);
      check("pair", task.pair, aligner_.plan().max_pairs);
      const Pyramid &f0 = aligner_.reference_grey(task.reference), &luma = aligner_.target_grey(task.pair);
      const std::span<const Map> rgb = aligner_.target_rgb(task.pair);
      const bool recoloured = task.grey != kLuma && !rgb.empty();
      Pyramid own = recoloured ? grey_pyramid(rgb, task.grey, static_cast<int>(luma.size())) : Pyramid();
      hide(own, luma);
      const Pyramid& f1 = recoloured ? own : luma;
      const Camera& camera = aligner_.camera(task.reference);
      const Features& features = aligner_.features(task.reference);
      const std::vector<FeatureCheck>& checks = aligner_.checks(task.reference);
      std::vector<AlignedFeature>& aligned = results.emplace_back(features.uv.size());
      for (size_t i = 0; i < aligned.size(); ++i) {
        if (checks[i] != FeatureCheck::ok) continue;
        const Eigen::Vector2d& uv0 = features.uv[i];
        const double q = features.inverse_depth[i];
        aligned[i] = align_feature(f0, f1, camera, uv0, q, task.T_10, options_);
        if (task.colours && !rgb.empty() && aligned[i].status == FeatureStatus::aligned)
          aligned[i].colours = colour_sums(f0[0], rgb, camera, uv0, q, task.T_10, aligned[i].uv1);
      }
    }
    return results;
  }

  int pairs_per_batch() const override { return aligner_.plan().max_pairs; }

 private:
  static void check(const char* what, int index, int count) {
    if (index < 0 || index >= count)
      throw Error(ErrorCode::invalid_argument,
                  std::string("feature alignment: ") + what + " " + std::to_string(index) + " is outside the plan");
  }

  const CpuAligner& aligner_;
  FeatureAlignmentOptions options_;
};

}  // namespace

std::unique_ptr<FeatureAligner> make_cpu_feature_aligner(const CpuAligner& aligner, const FeatureAlignmentOptions& options) {
  return std::make_unique<CpuFeatureAligner>(aligner, options);
}

}  // namespace iclk::internal
