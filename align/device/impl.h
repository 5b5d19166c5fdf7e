#pragma once
#include <iclk/align/common/input.h>
#include <iclk/align/device/device_image.h>
#include <iclk/align/device/stages.h>
#include <iclk/align/device/tiles.h>
#include <iclk/align/device_aligner.h>
#include <iclk/align/solver/lm.h>
#include <iclk/engine/submission.h>

namespace iclk {

/// State of a DeviceAligner, shared by its two ways to run: align() (device_aligner.cpp) and record() (recording.cpp).
struct DeviceAligner::Impl {
  struct Slot {
    bool set = false, dirty = false;  // dirty: pixels and features are there, pyramid and template are not
    bool recorded = false;            // dirty, and what ends it is recorded but not submitted
    Camera camera;
    Features features;
    std::vector<FeatureCheck> checks;
    double mean_inverse_depth = 0;
    bool enough = false;
    uint32_t chosen = 0;   // features that the device chooses; then the four before this are empty, and enough is true
    uint64_t version = 0;  // counts the images that were prepared
    bool on_host = false;  // its pixels are where set_reference() put them
  };

  Impl(std::shared_ptr<const engine::Context> context, const Plan& plan, const AlignerOptions& options, Solver solver,
       const std::shared_ptr<const Model>& model);

  std::shared_ptr<const engine::Context> context;
  Plan plan;
  AlignerOptions options;
  Solver solver;
  internal::Layout layout;
  internal::WorkgroupSizes sizes;
  int batch;
  internal::Kernels kernels;
  internal::DeviceImages images;  // made with the first recording
  internal::AlignerBuffers ids;
  internal::DeviceNetwork network;
  internal::DeviceMatching matching;
  engine::Workspace memory;
  internal::RunBuffers run_ids;
  engine::Workspace run;
  engine::DescriptorArena arena;
  std::unique_ptr<engine::StageTimer> timer;
  engine::Submission submission;  // after all that it uses: its destructor may have to wait
  std::vector<Slot> slots;
  std::vector<internal::Awaited> started;  // by start(), until finish()
  uint64_t targets_version = 0;            // counts the batches
  bool recorded = false;  // record() was called: images change whenever the application executes, and nothing is counted
  internal::TileLists tiles;
  std::vector<engine::StageTime> no_times;

  engine::ArenaSize arena_size() const;
  internal::Stages stages() const {
    return {layout, plan, options, sizes, kernels, ids, memory, run_ids, run, network, matching, most_features()};
  }
  /// Of the references that are set.
  uint32_t most_features() const;

  void check_pairs(std::span<const Pair> pairs) const;
  /// Host data of a slot: camera, features, verdicts. Pixels are another matter.
  void set_slot(int slot, const Camera& camera, const Features& features, double mean_inverse_depth,
                std::vector<FeatureCheck> checks);
  /// The same of a slot whose features the device will choose.
  void set_chosen_slot(int slot, const Camera& camera);
  /// Records what chooses them, in pixels that are there.
  void choose_features(engine::Recorder& recorder, int slot, const DeviceDepth& depth) const;
  /// Copies staged pixels of the references that set_reference() left for this recording, and returns which they are.
  std::vector<internal::Stages::Run> upload_dirty(engine::Recorder& recorder);
  /// What set_slot() has written for slots [first, first + count).
  void upload_tables(engine::Recorder& recorder, uint32_t first, uint32_t count) const;
  /// What upload_dirty() returned is prepared, now that the commands are submitted or the application's. Where recording or
  /// submitting fails, the slots stay dirty for the next attempt.
  void recorded_will_execute();
  void upload_targets(engine::Recorder& recorder, std::span<const Pair> pairs);
  /// Both images of every pair, ready to be aligned.
  void prepare(engine::Recorder& recorder, std::span<const Pair> pairs);
  /// Writes pair `index` of a run, a Pair or DevicePair.
  template <class AnyPair>
  void pack(const AnyPair& pair, uint32_t index, const internal::RunBuffers& to_ids, const engine::Workspace& to) const;
  template <class AnyPair>
  internal::Awaited await(const AnyPair& pair) const {
    const Slot& slot = slots[static_cast<size_t>(pair.reference)];
    return {slot.enough, pair.T_10, slot.camera, slot.mean_inverse_depth, pair.prior, slot.checks, slot.chosen};
  }
  void start(std::span<const Pair> pairs, const engine::Synchronisation& synchronisation);
  std::vector<Alignment> finish();
  void check_nothing_started() const;
  std::vector<Alignment> align_on_host(std::span<const Pair> pairs);
  void submit();

  class PixelMaps;

 private:
  struct HostRun;
};

}  // namespace iclk
