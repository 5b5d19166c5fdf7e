#include "python/aligner.h"

#include <algorithm>
#include <utility>

#include <iclk/align/device_aligner.h>
#include <iclk/engine/error.h>

#include "apps/session/any_aligner.h"

namespace iclk::python {

Aligner::Aligner(const Options& options, const Sizes& sizes, std::shared_ptr<engine::Context> context)
    : options_(options), sizes_(sizes), context_(std::move(context)) {
  // Whether a pair comes with a guess is said pair by pair.
  stages_ = options_.wish.stages(false, options_.folders);
  for (const ModelStage& stage : stages_) stage.aligner.check();
  options_.refiner.check();
  needs_.features = sizes_.features;
  Plan plan{sizes_.width, sizes_.height};
  plan.max_features = sizes_.features;
  plan.max_references = sizes_.references;
  plan.max_pairs = sizes_.batch;
  for (const ModelStage& stage : stages_) plan.check(stage.aligner);
}

void Aligner::Needs::add(const ImageView& image) {
  deep = deep || bytes_per_pixel(image.format) != static_cast<size_t>(channels(image.format));
  colour = colour || channels(image.format) > 1;
}

std::unique_ptr<Cascade> Aligner::make(const Needs& needs) const {
  Plan plan{sizes_.width, sizes_.height};
  plan.max_features = needs.features;
  plan.max_references = sizes_.references;
  plan.max_pairs = sizes_.batch;
  plan.target_masks = needs.masks;
  const bool colour = needs.colour || needs.masks;  // a mask goes into the alpha of four channels
  plan.format =
      needs.deep ? (colour ? PixelFormat::rgba32f : PixelFormat::r32f) : (colour ? PixelFormat::rgba8 : PixelFormat::r8);
  std::vector<Cascade::Step> steps;
  for (const ModelStage& stage : stages_) {
    const auto make = [solver = options_.solver, context = context_, plan, stage] {
      return make_any_aligner(solver, context, plan, stage.aligner, stage.model);
    };
    RefinerOptions refiner = options_.refiner;
    refiner.keep_unconfirmed = stage.model != nullptr;
    steps.push_back({model_name(stage.model.get()), make, options_.refine ? std::optional(refiner) : std::nullopt});
  }
  return std::make_unique<Cascade>(std::move(steps));
}

void Aligner::fit(const Needs& needs) {
  if (cascade_ && needs == needs_) return;
  std::unique_ptr<Cascade> cascade = make(needs);
  for (int slot = 0; cascade_ && slot < sizes_.references; ++slot)
    if (const Reference* kept = cascade_->reference(slot)) cascade->set_reference(slot, *kept);
  cascade_ = std::move(cascade);
  needs_ = needs;
}

std::vector<FeatureCheck> Aligner::set_reference(int slot, const Reference& reference) {
  Needs needs = needs_;
  needs.add(reference.image);
  needs.features = std::max(needs.features, reference.features.size());
  fit(needs);
  return cascade_->set_reference(slot, reference);
}

std::vector<RefinedAlignment> Aligner::align(std::vector<Pair> pairs) {
  Needs needs = needs_;
  for (Pair& pair : pairs) {
    needs.add(pair.target);
    needs.masks = needs.masks || !pair.target_mask.empty();
    pair.search = pair.search || options_.wish.search != "auto";
  }
  fit(needs);
  return cascade_->align(pairs);
}

std::string Aligner::device_name() const { return context_ ? context_->info().name : "CPU reference (one thread, no Vulkan)"; }

}  // namespace iclk::python
