#include <iclk/align/cpu/cpu_aligner.h>
#include <iclk/refine/internal/align_feature.h>
#include <iclk/refine/internal/feature_aligner.h>

namespace iclk::internal {
namespace {

class CpuFeatureAligner final : public FeatureAligner {
 public:
  CpuFeatureAligner(const CpuAligner& aligner, const FeatureAlignmentOptions& options) : aligner_(aligner), options_(options) {
    options_.check();
  }

  std::vector<AlignedFeatures> align(std::span<const FeatureAlignmentTask> tasks) override {
    std::vector<AlignedFeatures> results;
    for (const FeatureAlignmentTask& task : tasks) results.push_back(align(task));
    return results;
  }

  int pairs_per_batch() const override { return aligner_.plan().max_pairs; }

 private:
  AlignedFeatures align(const FeatureAlignmentTask& task) const {
    check(task, aligner_.plan().max_references, aligner_.plan().max_pairs);
    const Pyramid &f0 = aligner_.reference_grey(task.reference), &luma = aligner_.target_grey(task.pair);
    const std::span<const Map> rgb = aligner_.target_rgb(task.pair);
    const bool recoloured = task.grey != kLuma && !rgb.empty();
    Pyramid own = recoloured ? grey_pyramid(rgb, task.grey, static_cast<int>(luma.size())) : Pyramid();
    hide(own, luma);
    const Pyramid& f1 = recoloured ? own : luma;
    const Camera& camera = aligner_.camera(task.reference);
    const Features& features = aligner_.features(task.reference);
    AlignedFeatures aligned{std::vector<AlignedFeature>(features.uv.size()), {}};
    if (task.colours && !rgb.empty()) aligned.colours.resize(features.uv.size());
    for (size_t i = 0; i < features.uv.size(); ++i) {
      if (aligner_.checks(task.reference)[i] != FeatureCheck::ok) continue;
      const Eigen::Vector2d& uv0 = features.uv[i];
      const double q = features.inverse_depth[i];
      AlignedFeature& f = aligned.features[i] = align_feature(f0, f1, camera, uv0, q, task.T_10, options_, task.level);
      if (!aligned.colours.empty() && f.status == FeatureStatus::aligned)
        aligned.colours[i] = colour_sums(f0[0], rgb, camera, uv0, q, task.T_10, f.uv1);
    }
    return aligned;
  }

  const CpuAligner& aligner_;
  FeatureAlignmentOptions options_;
};

}  // namespace

std::unique_ptr<FeatureAligner> make_cpu_feature_aligner(const CpuAligner& aligner, const FeatureAlignmentOptions& options) {
  return std::make_unique<CpuFeatureAligner>(aligner, options);
}

}  // namespace iclk::internal
