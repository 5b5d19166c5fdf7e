#pragma once
#include <iclk/align/aligner.h>
#include <iclk/align/model.h>
#include <iclk/align/pyramid.h>

namespace iclk {

namespace internal {
struct MatchLayout;
}

/// The CPU reference: every stage in plain C++ and Eigen, with the same name as in shaders/. One thread.
class CpuAligner : public Aligner {
 public:
  /// model: null for the classical mode (grey pyramid).
  CpuAligner(const Plan& plan, const AlignerOptions& options, std::shared_ptr<const Model> model = nullptr);
  ~CpuAligner() override;

  std::vector<FeatureCheck> set_reference(int slot, const Reference& reference) override;
  using Aligner::align;
  std::vector<Alignment> align(std::span<const Pair> pairs) override;

  /// Inputs of the refinement. Preconditions: the slot is prepared; `pair` is an index in the last align() call.
  const Camera& camera(int slot) const override;
  const Features& features(int slot) const override;
  const std::vector<FeatureCheck>& checks(int slot) const override;
  const Plan& plan() const override { return plan_; }
  Map grey(int slot) const override { return reference_grey(slot)[0]; }
  /// The grey maps. With a model they are the kFeatureAlignmentLevels finest levels, at most AlignerOptions::levels. They are
  /// always made, because images are read during the call only and the encoder takes much longer.
  const Pyramid& reference_grey(int slot) const;
  const Pyramid& target_grey(int pair) const;
  /// The rgb_maps() of the target; empty for an image of one channel.
  std::span<const Map> target_rgb(int pair) const;

 private:
  struct Keyframe;
  struct Maps;
  struct Target {
    Pyramid grey;
    std::vector<Map> rgb;
  };
  Maps maps_of(const ImageView& image, const ImageView& mask = {}) const;
  Alignment align_one(const Keyframe& keyframe, const Pyramid& f1, const Map& grey1, const Pair& pair) const;

  Plan plan_;
  AlignerOptions options_;
  std::shared_ptr<const Model> model_;
  std::unique_ptr<const internal::MatchLayout> match_;  // null: no search by matching
  std::vector<std::unique_ptr<Keyframe>> keyframes_;
  std::vector<Target> targets_;
};

}  // namespace iclk
