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

/// What became of one pair, with the features of its reference that took part: those given, or those that were chosen.
/// RefinedAlignment::features and inverse_depth have one entry for each.
struct Answer : RefinedAlignment {
  Features reference_features;
};

/// Aligns pairs as `iclk align` does, and stays warm from call to call: the device, aligners of the right size, refinement.
/// Its answers are those of `iclk align`, to the bit. One thread at a time.
///
/// Aligners follow what the session is given: the size of the images, a device format that loses nothing of them, masks, as
/// many features as the largest reference has. Another kind of image costs a new aligner, as do more features.
///
/// If Pair::search (CascadePair::search) is false, T_10 is the pair's first guess. If it is true, the pair has none, and
/// SessionOptions::search decides where it begins.
class Session {
 public:
  /// Reads the models and opens the device. Throws Error(invalid_argument) that names a bad option, Error(io) for a model that
  /// is not there, and what open_device() throws.
  explicit Session(const SessionOptions& options = {});
  /// On a device of the caller's; null: SessionOptions::solver has to be Solver::cpu.
  Session(const SessionOptions& options, std::shared_ptr<engine::Context> context);
  ~Session();
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  /// One pair. Features are chosen where the reference has depth: SessionOptions::detector. `depth`: r32f metres along the
  /// optical axis, of the reference's size; 0, negative and not finite: none. `T_10`: first guess. All images have one size,
  /// which is the camera's. Throws Error(invalid_argument) for another size, NaN, a bad camera; Error(device_lost), ... What
  /// cannot be aligned is a status, never an exception.
  Answer align(const ImageView& reference, const ImageView& depth, const ImageView& target, const Camera& camera,
               const std::optional<SE3>& T_10 = {});
  /// The same with features of the caller's. Those without a sigma get that of SessionOptions::depth_sigma.
  Answer align(const Reference& reference, const ImageView& target, const std::optional<SE3>& T_10 = {});

  /// Pairs with references of their own; pixels are not copied. One answer a pair, in order. All images of a call have one
  /// size, which need not be that of the call before. Keyframes are forgotten. Throws as align() does.
  std::vector<RefinedAlignment> align(std::span<const CascadePair> pairs);
  RefinedAlignment align(const CascadePair& pair) { return std::move(align(std::span(&pair, 1)).front()); }
  /// Makes what align() of these pairs needs and would otherwise make itself.
  void prepare(std::span<const CascadePair> pairs);

  /// Prepares a keyframe for any number of targets; its pixels are copied. All keyframes have one size. Returns a verdict a
  /// feature. Throws Error(invalid_argument) for a slot outside SessionOptions::references, another size, NaN.
  std::vector<FeatureCheck> set_reference(int slot, const Reference& reference);
  /// What was given for a slot, with our copy of the pixels; null where it is not set.
  const Reference* reference(int slot) const { return cascade_ ? cascade_->reference(slot) : nullptr; }
  /// Targets of keyframes. One answer a pair, in order. Throws Error(invalid_argument) for a slot that is not set.
  std::vector<RefinedAlignment> align(std::span<const Pair> pairs);
  RefinedAlignment align(const Pair& pair) { return std::move(align(std::span(&pair, 1)).front()); }

  /// Says beforehand what keyframes will be, so that fewer aligners are made. Throws Error(invalid_argument) for a size that a
  /// model cannot align.
  void expect(int width, int height, int features);
  /// An aligner of the first model for a plan of the caller's, for a Tracker or a rig; its search is on unless SearchMode::off.
  /// Throws what make_device_aligner() and make_cpu_aligner() throw.
  std::unique_ptr<Aligner> make_aligner(const Plan& plan) const;

  const SessionOptions& options() const { return options_; }
  const std::vector<ModelStage>& stages() const { return stages_; }
  std::string device_name() const;
  const std::shared_ptr<engine::Context>& context() const { return context_; }  ///< null: Solver::cpu
  /// A CPU device was taken although nobody asked for it.
  bool cpu_unasked() const { return context_ && context_->cpu_unasked(); }
  /// ms of the last align(), with the aligners that were made for it.
  const Cascade::Times& times() const { return times_; }
  /// By model, ms of all calls; empty unless SessionOptions::profile.
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
  Needs keyframes_, made_;  // of all keyframes so far, and what cascade_ was made for
  std::unique_ptr<Cascade> cascade_;
  std::vector<std::pair<std::string, const DeviceAligner*>> device_aligners_;  // the cascade's, by model
  Cascade::Times times_;
  double making_ms_ = 0;  // of aligners since the last align()
};

/// A device format that loses nothing: 8-bit, or float for deeper images; one channel, or four for colours and masks.
PixelFormat lossless_format(bool deep, bool colour);

}  // namespace iclk
