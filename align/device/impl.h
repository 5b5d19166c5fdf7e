#pragma once
#include <iclk/align/common/input.h>
#include <iclk/align/device/device_image.h>
#include <iclk/align/device/stages.h>
#include <iclk/align/device/tiles.h>
#include <iclk/align/device_aligner.h>
#include <iclk/align/solver/lm.h>
#include <iclk/engine/submission.h>

namespace iclk {

/// The state of a DeviceAligner, shared by align() (device_aligner.cpp) and record() (recording.cpp).
struct DeviceAligner::Impl {
  struct Slot {
    bool set = false, dirty = false;  // dirty: has pixels and features, but not yet pyramid and template
    bool recorded = false;            // dirty; their computation is recorded but not submitted
    Camera camera;
    Features features;
    std::vector<FeatureCheck> checks;
    double mean_inverse_depth = 0;
    bool enough = false;
    uint32_t chosen = 0;   // features that the device chooses; then the fields for host features are empty, enough is true
    uint64_t version = 0;  // counts the prepared images
    bool on_host = false;  // set_reference() has copied its pixels
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
  internal::DeviceImages images;  // made by the first recording
  internal::AlignerBuffers ids;
  internal::DeviceNetwork network;
  internal::DeviceMatching matching;
  engine::Workspace memory;
  internal::RunBuffers run_ids;
  engine::Workspace run;
  engine::DescriptorArena arena;
  std::unique_ptr<engine::StageTimer> timer;
  engine::Submission submission;  // declared after everything that it uses, because its destructor waits
  std::vector<Slot> slots;
  std::vector<internal::Awaited> started;  // by start(), until finish()
  uint64_t targets_version = 0;            // counts the batches
  bool recorded = false;                   // record() was called: images change at every execution, which is not counted
  internal::TileLists tiles;
  std::vector<engine::StageTime> no_times;

  engine::ArenaSize arena_size() const;
  internal::Stages stages() const {
    return {layout, plan, options, sizes, kernels, ids, memory, run_ids, run, network, matching, most_features()};
  }
  /// The largest number of features of a reference that is set.
  uint32_t most_features() const;

  void check_pairs(std::span<const Pair> pairs) const;
  /// Sets the host data of a slot: camera, features, verdicts; not the pixels.
  void set_slot(int slot, const Camera& camera, const Features& features, double mean_inverse_depth,
                std::vector<FeatureCheck> checks);
  /// The same for a slot whose features the device will choose.
  void set_chosen_slot(int slot, const Camera& camera);
  /// Records the choice of features. Precondition: the pixels are set.
  void choose_features(engine::Recorder& recorder, int slot, const DeviceDepth& depth) const;
  /// Records the copies of staged pixels of dirty references, and returns these references.
  std::vector<internal::Stages::Run> upload_dirty(engine::Recorder& recorder);
  /// Records the upload of the host data of slots [first, first + count).
  void upload_tables(engine::Recorder& recorder, uint32_t first, uint32_t count) const;
  /// Marks the references of upload_dirty() as prepared. Call it after the submission, or when the application has the
  /// commands. If recording or submitting fails, do not call it; the slots stay dirty.
  void recorded_will_execute();
  void upload_targets(engine::Recorder& recorder, std::span<const Pair> pairs);
  /// Records the preparation of both images of every pair.
  void prepare(engine::Recorder& recorder, std::span<const Pair> pairs);
  /// Writes pair `index` of a run; AnyPair is Pair or DevicePair.
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
