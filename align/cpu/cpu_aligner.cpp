#include <iclk/align/cpu/cpu_aligner.h>

#include <algorithm>

#include <iclk/align/common/input.h>
#include <iclk/align/model/model_check.h>
#include <iclk/align/network/m_estimator.h>
#include <iclk/align/search/matching.h>
#include <iclk/align/solver/agreement.h>
#include <iclk/align/solver/jacobian.h>
#include <iclk/align/solver/lm.h>
#include <iclk/align/solver/mask.h>
#include <iclk/align/solver/verdict.h>
#include <iclk/align/solver/weights.h>
#include <iclk/engine/error.h>

namespace iclk {

struct CpuAligner::Keyframe {
  Camera camera;
  Features features;
  std::vector<FeatureCheck> checks;
  Pyramid grey;
  Map match;                               // for the search by matching
  std::vector<internal::Template> levels;  // finest first
  double mean_inverse_depth = 0;
};

struct CpuAligner::Maps {
  Pyramid grey, learned;  // learned: empty without a model
  const Pyramid& aligned() const { return learned.empty() ? grey : learned; }
};

CpuAligner::CpuAligner(const Plan& plan, const AlignerOptions& options, std::shared_ptr<const Model> model)
    : plan_(plan), options_(options), model_(std::move(model)) {
  plan_.check(options_);
  if (const internal::MatchLayout match(plan_, options_); match.enabled)
    match_ = std::make_unique<internal::MatchLayout>(match);
  if (model_) {
    internal::check_model(*model_);
    internal::check_model_use(*model_, options_);
  }
  keyframes_.resize(static_cast<size_t>(plan_.max_references));
}

CpuAligner::~CpuAligner() = default;

CpuAligner::Maps CpuAligner::maps_of(const ImageView& image, const ImageView& mask) const {
  Maps maps;
  maps.grey = grey_pyramid(image, model_ ? std::min(options_.levels, kFeatureAlignmentLevels) : options_.levels);
  if (model_) maps.learned = internal::encode(*model_, image, options_.levels);
  hide(maps.grey, mask);
  hide(maps.learned, mask);
  return maps;
}

std::vector<FeatureCheck> CpuAligner::set_reference(int slot, const Reference& reference) {
  internal::check_slot(slot, plan_);
  internal::check_reference(reference, plan_);
  auto keyframe = std::make_unique<Keyframe>();
  keyframe->camera = reference.camera;
  keyframe->features = reference.features;
  keyframe->checks = check_features(reference.features, reference.camera);
  keyframe->mean_inverse_depth = internal::mean_inverse_depth(reference, keyframe->checks, plan_.dense);
  Maps maps = maps_of(reference.image);
  Map q;
  for (int level = 0; level < options_.levels; ++level) {
    const Map& f0 = maps.aligned()[static_cast<size_t>(level)];
    if (plan_.dense) {
      q = level == 0 ? internal::dense_inverse_depth(reference.inverse_depth) : internal::half_inverse_depth(q);
      keyframe->levels.push_back(internal::dense_template(f0, q));
    } else {
      const auto mask = internal::sparse_mask(reference.features, keyframe->checks, reference.camera, level);
      keyframe->levels.push_back(internal::sparse_template(f0, reference.features, mask, level));
    }
  }
  if (match_) keyframe->match = internal::match_map(maps.grey[0], *match_);
  keyframe->grey = std::move(maps.grey);
  auto& kept = keyframes_[static_cast<size_t>(slot)];
  kept = std::move(keyframe);
  return kept->checks;
}

std::vector<Alignment> CpuAligner::align(std::span<const Pair> pairs) {
  for (size_t i = 0; i < pairs.size(); ++i) {
    internal::check_pair(pairs[i], i, plan_);
    if (!keyframes_[static_cast<size_t>(pairs[i].reference)])
      throw Error(ErrorCode::invalid_argument, "pair " + std::to_string(i) + ": reference slot " +
                                                   std::to_string(pairs[i].reference) + " was never set; call set_reference");
  }
  targets_.assign(pairs.size(), {});
  std::vector<Alignment> out;
  out.reserve(pairs.size());
  for (size_t i = 0; i < pairs.size(); ++i) {
    Maps maps = maps_of(pairs[i].target, pairs[i].target_mask);
    out.push_back(align_one(*keyframes_[static_cast<size_t>(pairs[i].reference)], maps.aligned(), maps.grey[0], pairs[i]));
    targets_[i].grey = std::move(maps.grey);
    if (channels(pairs[i].target.format) > 1) targets_[i].rgb = rgb_maps(pairs[i].target);
  }
  return out;
}

Alignment CpuAligner::align_one(const Keyframe& keyframe, const Pyramid& f1, const Map& grey1, const Pair& pair) const {
  if (!internal::enough_to_align(keyframe.checks, keyframe.mean_inverse_depth, plan_, options_))
    return internal::too_few_features(keyframe.checks, pair.T_10, options_);

  Alignment out;
  out.features = keyframe.checks;
  Map weight;  // of the M-estimator, from the previous level
  internal::Agreement agreement;
  internal::MatchedStart matched;
  if (match_ && pair.search && pair.found)
    matched.T_10 = pair.T_10;
  else if (match_ && pair.search)
    matched = internal::matched_start(keyframe.match, internal::match_map(grey1, *match_), keyframe.features, keyframe.checks,
                                      keyframe.camera, keyframe.mean_inverse_depth, *match_);
  const int first_level = matched.T_10 ? match_->first_level : options_.levels - 1;
  internal::LmIteration lm({&options_, pair.prior ? &*pair.prior : nullptr, keyframe.mean_inverse_depth},
                           matched.T_10.value_or(pair.T_10));
  for (int level = options_.levels - 1; level >= 0; --level) {
    const Camera camera = keyframe.camera.at_level(level);
    const internal::Template& pixels = keyframe.levels[static_cast<size_t>(level)];
    const Map& target = f1[static_cast<size_t>(level)];
    if (level == options_.levels - 1 && options_.photometric)
      lm.start_photometric(internal::normal_equations(pixels, target, camera, lm.point(), {}));

    LevelTrace trace;
    trace.level = level;
    const bool skips = level > first_level;
    if (!skips) lm.begin_level(camera);
    std::vector<float> weights;
    if (options_.robust != Robust::unit) {  // once per level, from the residual at its start
      const auto r = internal::residuals(pixels, target, camera, lm.point());
      trace.scale = internal::mad_scale(r);
      weights = internal::robust_weights(options_.robust, r, static_cast<float>(trace.scale));
    } else if (model_ && !model_->m_estimator.empty()) {
      weights = internal::m_estimator_weights(*model_, pixels, target, camera, lm.point(), weight);
    }
    for (int i = 0; i < options_.iterations && !skips && !lm.level_done(); ++i)
      trace.iterations.push_back(lm.step(internal::normal_equations(pixels, target, camera, lm.point(), weights)));
    if (!skips && (level == 0 || options_.damping == Damping::adaptive))
      lm.end_level(internal::normal_equations(pixels, target, camera, lm.point(), weights));
    if (level == 0) agreement = internal::agreement(pixels, target, camera, lm.point(), weights);
    out.levels.push_back(std::move(trace));
  }
  internal::conclude({lm.point(), lm.sums(), agreement, lm.singular(), lm.last_step(), keyframe.camera,
                      keyframe.mean_inverse_depth, pair.prior ? &*pair.prior : nullptr, matched.repeats},
                     options_, out);
  return out;
}

const Camera& CpuAligner::camera(int slot) const { return keyframes_.at(static_cast<size_t>(slot))->camera; }
const Features& CpuAligner::features(int slot) const { return keyframes_.at(static_cast<size_t>(slot))->features; }
const std::vector<FeatureCheck>& CpuAligner::checks(int slot) const { return keyframes_.at(static_cast<size_t>(slot))->checks; }
const Pyramid& CpuAligner::reference_grey(int slot) const { return keyframes_.at(static_cast<size_t>(slot))->grey; }
const Pyramid& CpuAligner::target_grey(int pair) const { return targets_.at(static_cast<size_t>(pair)).grey; }
std::span<const Map> CpuAligner::target_rgb(int pair) const { return targets_.at(static_cast<size_t>(pair)).rgb; }

std::unique_ptr<Aligner> make_cpu_aligner(const Plan& plan, const AlignerOptions& options, std::shared_ptr<const Model> model) {
  return std::make_unique<CpuAligner>(plan, options, std::move(model));
}

}  // namespace iclk
