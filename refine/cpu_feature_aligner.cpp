#include <string>
#include <utility>

#include <iclk/align/cpu_aligner.h>
#include <iclk/engine/error.h>
#include <iclk/refine/feature_aligner.h>

namespace iclk {
namespace {

class CpuFeatureAligner final : public FeatureAligner {
 public:
  CpuFeatureAligner(std::unique_ptr<FeatureMaps> maps, const FeatureAlignmentOptions& options)
      : maps_(std::move(maps)), options_(options) {
    options_.check();
  }

  std::vector<std::vector<AlignedFeature>> align(std::span<const FeatureAlignmentTask> tasks) override {
    std::vector<std::vector<AlignedFeature>> results;
    results.reserve(tasks.size());
    for (const FeatureAlignmentTask& task : tasks) {
      const Pyramid &f0 = maps_->reference_grey(task.reference), &luma = maps_->target_grey(task.pair);
      const std::span<const Map> rgb = maps_->target_rgb(task.pair);
      const bool recoloured = task.grey != kLuma && !rgb.empty();
      Pyramid own = recoloured ? grey_pyramid(rgb, task.grey, static_cast<int>(luma.size())) : Pyramid();
      hide(own, luma);
      const Pyramid& f1 = recoloured ? own : luma;
      const Camera& camera = maps_->camera(task.reference);
      const Features& features = maps_->features(task.reference);
      const std::vector<FeatureCheck>& checks = maps_->checks(task.reference);
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

  int pairs_per_batch() const override { return maps_->pairs_per_batch(); }

 private:
  std::unique_ptr<FeatureMaps> maps_;
  FeatureAlignmentOptions options_;
};

/// The maps of a CpuAligner, whose own accessors take the indices on trust.
class CpuAlignerMaps final : public FeatureMaps {
 public:
  explicit CpuAlignerMaps(const CpuAligner& aligner) : aligner_(aligner) {}
  const Pyramid& reference_grey(int slot) const override { return aligner_.reference_grey(in_range("slot", slot)); }
  const Pyramid& target_grey(int pair) const override {
    if (pair < 0 || pair >= aligner_.plan().max_pairs) refuse("pair", pair);
    return aligner_.target_grey(pair);
  }
  std::span<const Map> target_rgb(int pair) const override {
    if (pair < 0 || pair >= aligner_.plan().max_pairs) refuse("pair", pair);
    return aligner_.target_rgb(pair);
  }
  const Camera& camera(int slot) const override { return aligner_.camera(in_range("slot", slot)); }
  const Features& features(int slot) const override { return aligner_.features(in_range("slot", slot)); }
  const std::vector<FeatureCheck>& checks(int slot) const override { return aligner_.checks(in_range("slot", slot)); }
  int pairs_per_batch() const override { return aligner_.plan().max_pairs; }

 private:
  [[noreturn]] static void refuse(const char* what, int index) {
    throw Error(ErrorCode::invalid_argument,
                std::string("feature alignment: ") + what + " " + std::to_string(index) + " is outside the plan");
  }
  int in_range(const char* what, int slot) const {
    if (slot < 0 || slot >= aligner_.plan().max_references) refuse(what, slot);
    return slot;
  }
  const CpuAligner& aligner_;
};

}  // namespace

std::unique_ptr<FeatureAligner> make_cpu_feature_aligner(std::unique_ptr<FeatureMaps> maps,
                                                         const FeatureAlignmentOptions& options) {
  return std::make_unique<CpuFeatureAligner>(std::move(maps), options);
}

std::unique_ptr<FeatureAligner> make_cpu_feature_aligner(const CpuAligner& aligner, const FeatureAlignmentOptions& options) {
  return make_cpu_feature_aligner(std::make_unique<CpuAlignerMaps>(aligner), options);
}

}  // namespace iclk
