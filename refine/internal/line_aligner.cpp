#include <iclk/refine/internal/line_aligner.h>

#include <iclk/align/common/each.h>

namespace iclk::internal {
namespace {

class LineAligner final : public FeatureAligner {
 public:
  LineAligner(const Reference& reference, std::span<const FeatureCheck> checks, const LinePatches& patches, int threads)
      : reference_(reference), checks_(checks), patches_(patches), threads_(threads) {}

  std::vector<AlignedFeatures> align(std::span<const FeatureAlignmentTask> tasks) override {
    std::vector<AlignedFeatures> results;
    for (const FeatureAlignmentTask& task : tasks) results.push_back(align(task));
    return results;
  }
  int pairs_per_batch() const override { return 1; }

 private:
  AlignedFeatures align(const FeatureAlignmentTask& task) const {
    constexpr int kReach = 6;  // px
    const Features& features = reference_.features;
    AlignedFeatures found{std::vector<AlignedFeature>(features.uv.size()), {}};
    for_each_of(features.uv.size(), threads_, [&](size_t i) {
      AlignedFeature& f = found.features[i];
      if (checks_[i] != FeatureCheck::ok) return;
      const auto compared = patches_.find(reference_.camera, features.uv[i], features.inverse_depth[i], task.T_10, kReach);
      f.status = !compared ? FeatureStatus::low_texture : compared->match ? FeatureStatus::aligned : FeatureStatus::diverged;
      if (f.status == FeatureStatus::aligned) f.uv1 = compared->match->pixel;
    });
    return found;
  }

  const Reference& reference_;
  std::span<const FeatureCheck> checks_;
  const LinePatches& patches_;
  int threads_;
};

}  // namespace

std::unique_ptr<FeatureAligner> make_line_aligner(const Reference& reference, std::span<const FeatureCheck> checks,
                                                  const LinePatches& patches, int threads) {
  return std::make_unique<LineAligner>(reference, checks, patches, threads);
}

}  // namespace iclk::internal
