#pragma once
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/engine/context.h>
#include <iclk/engine/timing.h>
#include <iclk/refine/cascade.h>
#include <iclk/session/options.h>

namespace iclk {

class DeviceAligner;

/// The result of one pair, with the features of its reference that were used: given or chosen ones.
/// RefinedAlignment::features and inverse_depth have one entry for each.
struct Answer : RefinedAlignment {
  Features reference_features;
};

/// Aligns pairs like `iclk align`, with bit-identical results. It keeps device, aligners and refiners between calls. One thread
/// at a time.
///
/// The session makes aligners that fit its inputs: image size, a lossless device format, masks, and the number of features of
/// the largest reference. Images of another size or format, and references with more features, need new aligners.
///
/// If Pair::search (CascadePair::search) is false, T_10 is the first guess of the pair. If it is true, the pair has no first
/// guess, and SessionOptions::search decides where it starts.
class Session {
 public:
  /// Reads the models and opens the device. Throws Error(invalid_argument) that names a bad option, Error(io) for a missing
  /// model, and the errors of open_device().
  explicit Session(const SessionOptions& options = {});
  /// Uses a given device. It may be null only with Solver::cpu in SessionOptions::solver.
  Session(const SessionOptions& options, std::shared_ptr<engine::Context> context);
  ~Session();
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  /// Aligns one pair. SessionOptions::detector chooses features where the reference has depth. `depth`: r32f, metres along the
  /// optical axis, of the size of the reference; 0, negative or not finite: unknown. `T_10`: the first guess. All images must
  /// have the size of the camera. Throws Error(invalid_argument) for other sizes, NaN and a bad camera; Error(device_lost);
  /// Error(out_of_memory). Pairs that cannot be aligned get a status; they never throw.
  Answer align(const ImageView& reference, const ImageView& depth, const ImageView& target, const Camera& camera,
               const std::optional<SE3>& T_10 = {});
  /// The same, with given features. Features without a sigma get that of SessionOptions::depth_sigma.
  Answer align(const Reference& reference, const ImageView& target, const std::optional<SE3>& T_10 = {});

  /// Aligns pairs with their own references; pixels are not copied. Returns one result per pair, in order. All images of a call
  /// must have one size, which may differ from call to call. All keyframes are discarded. Throws the errors of align().
  std::vector<RefinedAlignment> align(std::span<const CascadePair> pairs);
  RefinedAlignment align(const CascadePair& pair) { return std::move(align(std::span(&pair, 1)).front()); }
  /// Makes the aligners for these pairs now, so that align() need not.
  void prepare(std::span<const CascadePair> pairs);

  /// Prepares a keyframe for any number of targets; its pixels are copied. All keyframes must have one size. Returns one
  /// verdict per feature. Throws Error(invalid_argument) for a slot outside SessionOptions::references, another size, and NaN.
  std::vector<FeatureCheck> set_reference(int slot, const Reference& reference);
  /// The reference of a slot, with the copy of its pixels; null if the slot is not set.
  const Reference* reference(int slot) const { return cascade_ ? cascade_->reference(slot) : nullptr; }
  /// Aligns targets with keyframes. Returns one result per pair, in order. Throws Error(invalid_argument) for a slot that is
  /// not set, and the errors of align().
  std::vector<RefinedAlignment> align(std::span<const Pair> pairs);
  RefinedAlignment align(const Pair& pair) { return std::move(align(std::span(&pair, 1)).front()); }

  /// Announces the size and the number of features of later keyframes, so that fewer aligners are made. Throws
  /// Error(invalid_argument) for a size that a model cannot align.
  void expect(int width, int height, int features);
  /// Makes an aligner of the first model for a given plan, for a Tracker or a rig. Its search is on unless SearchMode::off.
  /// Throws the errors of make_device_aligner() and make_cpu_aligner().
  std::unique_ptr<Aligner> make_aligner(const Plan& plan) const;

  const SessionOptions& options() const { return options_; }
  const std::vector<ModelStage>& stages() const { return stages_; }
  std::string device_name() const;
  const std::shared_ptr<engine::Context>& context() const { return context_; }  ///< null: Solver::cpu
  /// A CPU device was chosen although SessionOptions::device did not name it.
  bool cpu_unasked() const { return context_ && context_->cpu_unasked(); }
  /// The times of the last align() in ms, including those of making aligners for it.
  const Cascade::Times& times() const { return times_; }
  /// The times of the stages of each model, sums over all calls; empty unless SessionOptions::profile.
  std::vector<std::pair<std::string, std::vector<engine::StageTime>>> stage_times() const;

 private:
  struct Needs {
    int width = 0, height = 0, features = 1, references = 1;
    bool deep = false, colour = false, masks = false, search = false;
    void add(const ImageView& image);
    bool serves(const Needs& other) const;
  };
  Plan plan_for(const Needs& needs) const;
  std::unique_ptr<Cascade> make_cascade(const Needs& needs);
  void make(const Needs& needs, bool keep_references);
  Needs needs_of(std::span<const CascadePair> pairs) const;
  bool searches(bool without_guess) const;
  void count(const Cascade::Times& before);

  SessionOptions options_;
  std::vector<ModelStage> stages_;
  std::shared_ptr<engine::Context> context_;
  Needs keyframes_, made_;  // of all keyframes so far; those that cascade_ was made for
  std::unique_ptr<Cascade> cascade_;
  std::vector<std::pair<std::string, const DeviceAligner*>> device_aligners_;  // of cascade_, with the names of their models
  Cascade::Times times_;
  double making_ms_ = 0;  // of aligners since the last align()
};

/// The lossless device format: 8-bit, or float if `deep`; one channel, or four if `colour` (also for masks).
PixelFormat lossless_format(bool deep, bool colour);

}  // namespace iclk
