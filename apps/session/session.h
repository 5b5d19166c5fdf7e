#pragma once
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/align/model.h>
#include <iclk/engine/context.h>
#include <iclk/refine/cascade.h>

#include "apps/session/alignment_wish.h"
#include "apps/session/pair_input.h"

namespace iclk {

class DeviceAligner;

struct SessionOptions {
  Solver solver = Solver::host;
  std::string device;  ///< index, part of a name, UUID; empty: ICLK_DEVICE, else the best
  AlignerOptions aligner;
  std::shared_ptr<const Model> model;  ///< null: the classical mode
  std::vector<ModelStage> then;        ///< models that get the pairs which those before did not settle
  bool dense = false;                  ///< every pixel with depth instead of patches; needs a depth image
  bool search_guessed = false;         ///< search, where it is enabled, for pairs with a first guess too
  bool refine = true;
  RefinerOptions refiner;  ///< keep_unconfirmed is each model's own: with a learned one
  int max_pairs = 1;       ///< in one batch on the device
  bool profile = false;    ///< let the device keep the time of its stages

  /// As --model has it: "auto", "classical" or the model's own name.
  std::string model_name() const;
};

/// Where a run spent its time, ms.
struct SessionTimes {
  double setup = 0;    ///< aligner and its memory; 0 when they were there already
  double prepare = 0;  ///< references
  double align = 0;    ///< ICLK and refinement
};

/// What runs pairs: the device, an aligner of the right size, the refinement. One thread at a time.
class Session {
 public:
  /// Opens the device. Throws Error(no_driver), Error(no_device), Error(invalid_argument) for bad options.
  explicit Session(const SessionOptions& options);

  /// One result a pair, in order. All images of one call have one size and format, and all targets a mask or none; others
  /// than the call before make new plans.
  std::vector<RefinedAlignment> run(std::span<const PairInput> pairs);
  RefinedAlignment run(const PairInput& pair) { return std::move(run(std::span(&pair, 1)).front()); }

  const std::string& device_name() const { return device_name_; }
  /// A CPU device was taken although nobody asked for it.
  bool cpu_unasked() const { return context_ && context_->cpu_unasked(); }
  const SessionTimes& times() const { return times_; }
  /// The times of the last run as lines of text; with those of the device's stages where the solver keeps them.
  std::string profile_text(const PairInput& pair) const;
  const SessionOptions& options() const { return options_; }
  const std::shared_ptr<engine::Context>& context() const { return context_; }

 private:
  void make_aligner(const PairInput& pair, int features);
  void make_plan(const Plan& plan);

  SessionOptions options_;
  std::shared_ptr<engine::Context> context_;
  std::string device_name_;
  Plan plan_;
  std::unique_ptr<Cascade> cascade_;
  std::vector<std::pair<std::string, const DeviceAligner*>> device_aligners_;  // the cascade's, by model
  SessionTimes times_;
};

}  // namespace iclk
