#pragma once
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <iclk/engine/context.h>
#include <iclk/refine/cascade.h>

#include "python/options.h"

namespace iclk::python {

/// What `iclk align` does (apps/session/session.h), for keyframes and targets in memory. Its plan follows what it is given: a
/// device format that loses nothing of the images, masks, and as many features as the largest keyframe has. One thread at a
/// time, without the GIL.
class Aligner {
 public:
  struct Sizes {
    int width = 0, height = 0, references = 1, batch = 1, features = 1;
  };

  /// `context` is null for Solver::cpu. Throws Error(invalid_argument) for options that cannot be, Error(io) for a model.
  Aligner(const Options& options, const Sizes& sizes, std::shared_ptr<engine::Context> context);

  std::vector<FeatureCheck> set_reference(int slot, const Reference& reference);
  /// Pairs with a first guess have Pair::search = false; whether it holds is up to the options. At most `sizes.batch` pairs.
  std::vector<RefinedAlignment> align(std::vector<Pair> pairs);

  /// What was given for a slot; null where it is not set.
  const Reference* reference(int slot) const { return cascade_ ? cascade_->reference(slot) : nullptr; }
  const Sizes& sizes() const { return sizes_; }
  bool on_cpu() const { return context_ == nullptr; }
  std::string device_name() const;

 private:
  struct Needs {
    bool deep = false, colour = false, masks = false;
    int features = 1;
    void add(const ImageView& image);
    bool operator==(const Needs&) const = default;
  };
  void fit(const Needs& needs);
  std::unique_ptr<Cascade> make(const Needs& needs) const;

  Options options_;
  Sizes sizes_;
  std::shared_ptr<engine::Context> context_;
  std::vector<ModelStage> stages_;
  Needs needs_;  // of cascade_
  std::unique_ptr<Cascade> cascade_;
};

}  // namespace iclk::python
