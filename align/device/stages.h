#pragma once
#include <optional>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/align/device/device_matching.h>
#include <iclk/align/device/kernels.h>
#include <iclk/align/network/device_network.h>
#include <iclk/align/solver/verdict.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/engine/compute/recorder.h>

namespace iclk::internal {

/// Buffers of an aligner: images, maps, templates.
struct AlignerBuffers {
  AlignerBuffers(const Layout& layout, const Plan& plan, Solver solver, const WorkgroupSizes& sizes, bool unified_memory,
                 int batch);

  engine::MemoryPlan plan;
  engine::BufferId levels, references, features, tiles, entries, pixels0, pixels1, maps0, maps1, mask, template_a, template_b,
      weights, parts;
  std::optional<engine::BufferId> staging0, staging1, staging_depth;  // if device memory is not mapped
};

/// Buffers of one run over a batch: the pairs from the host, and the results of the device solver.
struct RunBuffers {
  RunBuffers(const Layout& layout, const Plan& plan, Solver solver, bool unified_memory, int pairs);

  engine::MemoryPlan plan;
  engine::BufferId pairs, states, trace, results;
  std::optional<engine::BufferId> given;     // Solver::device: `pairs` from the host, because matching changes `pairs`
  std::optional<engine::BufferId> features;  // of each pair's reference; Plan::choose_features
  std::optional<engine::BufferId> states_read, trace_read, features_read;  // if device memory is not mapped
};

/// The number of workgroups of one level's normal equations.
uint32_t partial_groups(const Layout& layout, const WorkgroupSizes& sizes, int level);

/// Records the named stages of an alignment. It owns nothing.
struct Stages {
  const Layout& layout;
  const Plan& plan;
  const AlignerOptions& options;
  const WorkgroupSizes& sizes;
  const Kernels& kernels;
  const AlignerBuffers& ids;
  const engine::Workspace& memory;
  const RunBuffers& run_ids;
  const engine::Workspace& run;
  const DeviceNetwork& network;
  const DeviceMatching& matching;
  uint32_t features;  // of any reference, at most

  /// References [first, first + count).
  struct Run {
    uint32_t first, count;
  };
  /// Maps (grey pyramid or encoder) of these references and of the first `targets` targets.
  void maps(engine::Recorder& recorder, std::span<const Run> references, uint32_t targets) const;
  /// Mask and Jacobian of references with maps.
  void prepare(engine::Recorder& recorder, const Run& references) const;
  /// Search: replaces the poses of matched pairs among the first `pairs` PairInfo (PairInfo::matched). Without a search it does
  /// nothing.
  void match(engine::Recorder& recorder, uint32_t pairs) const;
  /// Residuals and weights at the start of a level; with unit weights it does nothing.
  void weights(engine::Recorder& recorder, int level, uint32_t pairs, uint32_t flags) const;
  /// One evaluation of the sums, as partial sums.
  void normal_equations(engine::Recorder& recorder, int level, uint32_t pairs, uint32_t iteration, uint32_t flags) const;
  /// The sums of Agreement at the pose of the finest level, as partial sums.
  void agreement(engine::Recorder& recorder, uint32_t pairs, uint32_t flags) const;
  /// The whole coarse-to-fine alignment of the device solver, including the verdict.
  void align(engine::Recorder& recorder, uint32_t pairs) const;
  /// Copies the present features of this slot for pair `pair` of the run. Precondition: Plan::choose_features.
  void keep_features(engine::Recorder& recorder, uint32_t slot, uint32_t pair) const;
  /// Makes states, trace and kept features readable for the host.
  void read_back(engine::Recorder& recorder, uint32_t pairs) const;

  /// The buffers of a level of the references and of the targets.
  const engine::Buffer& map0(int level) const { return at(level == 0 && layout.level0_in_pixels ? ids.pixels0 : ids.maps0); }
  const engine::Buffer& map1(int level) const { return at(level == 0 && layout.level0_in_pixels ? ids.pixels1 : ids.maps1); }

  /// The descriptors of one recording.
  static engine::ArenaSize arena_size(const Kernels& kernels, const DeviceNetwork& network, const DeviceMatching& matching);

 private:
  void enable(engine::Recorder& recorder, uint32_t pairs) const;
  void result(engine::Recorder& recorder, uint32_t pairs) const;
  const engine::Buffer& at(engine::BufferId id) const { return memory[id]; }
  shaders::IteratePush push(int level, uint32_t iterations, uint32_t flags) const;
  void iterate(engine::Recorder& recorder, int level, uint32_t pairs, uint32_t iterations, uint32_t flags) const;
};

/// The features on the device; unused ones have an inverse depth of 0.
Features unpack_features(const shaders::FeatureInfo* features, uint32_t count);

/// The mapped states, features and trace that the host can read.
const shaders::PairState* read_states(const RunBuffers& ids, const engine::Workspace& run);
const shaders::FeatureInfo* read_features(const RunBuffers& ids, const engine::Workspace& run);
const shaders::TraceEntry* read_trace(const RunBuffers& ids, const engine::Workspace& run);

NormalSums unpack_sums(const float* sums);
Agreement unpack_agreement(const float* sums);
SE3 unpack_pose(const float* pose);
void pack_pose(const SE3& T, float* pose);
shaders::PairInfo pack_pair(const SE3& T_10, const PosePrior* prior, int reference, uint32_t target, bool enabled,
                            const AlignerOptions& options);

/// A submitted or recorded pair with the data for its verdict, because its slot may be set again before the result is read.
struct Awaited {
  bool enough;
  SE3 T_10;
  Camera camera;
  double mean_inverse_depth;
  std::optional<PosePrior> prior;
  std::vector<FeatureCheck> checks;
  uint32_t chosen = 0;  // features that the device chose; if not 0, the fields for host features are not known yet

  /// Sets the features that the device has chosen. Precondition: chosen > 0.
  void take(const shaders::FeatureInfo* features, const AlignerOptions& options);
  /// Judges the result of the device solver.
  Alignment conclude(const shaders::PairState& state, const shaders::TraceEntry* trace, const AlignerOptions& options) const;
};

}  // namespace iclk::internal
