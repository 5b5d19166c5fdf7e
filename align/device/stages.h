#pragma once
#include <optional>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/align/device/kernels.h>
#include <iclk/align/network/device_network.h>
#include <iclk/align/device/device_matching.h>
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
  std::optional<engine::BufferId> staging0, staging1, staging_depth;  // where device memory cannot be mapped
};

/// Buffers of one run over a batch: what the host says of the pairs and what the device solver leaves.
struct RunBuffers {
  RunBuffers(const Layout& layout, const Plan& plan, Solver solver, bool unified_memory, int pairs);

  engine::MemoryPlan plan;
  engine::BufferId pairs, states, trace, results;
  std::optional<engine::BufferId> given;     // Solver::device: `pairs` as the host has them; matching changes `pairs`
  std::optional<engine::BufferId> features;  // of each pair's reference; Plan::choose_features
  std::optional<engine::BufferId> states_read, trace_read, features_read;  // where device memory cannot be mapped
};

/// Workgroups that one level's normal equations take.
uint32_t partial_groups(const Layout& layout, const WorkgroupSizes& sizes, int level);

/// Records the stages of an alignment, each under its name. Everything is borrowed.
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
  /// Mask and Jacobian of references that have maps.
  void prepare(engine::Recorder& recorder, const Run& references) const;
  /// Replaces the poses of those of the first `pairs` PairInfo that it can match (PairInfo::matched). Nothing without a search.
  void match(engine::Recorder& recorder, uint32_t pairs) const;
  /// Residual and weights with which a level starts; nothing with unit weights.
  void weights(engine::Recorder& recorder, int level, uint32_t pairs, uint32_t flags) const;
  /// One evaluation of the sums, in parts.
  void normal_equations(engine::Recorder& recorder, int level, uint32_t pairs, uint32_t iteration, uint32_t flags) const;
  /// What both images' gradients say of the finest level's pose, in parts.
  void agreement(engine::Recorder& recorder, uint32_t pairs, uint32_t flags) const;
  /// The whole coarse-to-fine alignment of the device solver, verdict included.
  void align(engine::Recorder& recorder, uint32_t pairs) const;
  /// Keeps the features of this slot for pair `pair` of the run, as they are now. Precondition: Plan::choose_features.
  void keep_features(engine::Recorder& recorder, uint32_t slot, uint32_t pair) const;
  /// Makes states, trace and kept features readable for the host.
  void read_back(engine::Recorder& recorder, uint32_t pairs) const;

  /// Where a level of the references or of the targets lies.
  const engine::Buffer& map0(int level) const { return at(level == 0 && layout.level0_in_pixels ? ids.pixels0 : ids.maps0); }
  const engine::Buffer& map1(int level) const { return at(level == 0 && layout.level0_in_pixels ? ids.pixels1 : ids.maps1); }

  /// Room in a descriptor arena for one recording.
  static engine::ArenaSize arena_size(const Kernels& kernels, const DeviceNetwork& network, const DeviceMatching& matching);

 private:
  void enable(engine::Recorder& recorder, uint32_t pairs) const;
  void result(engine::Recorder& recorder, uint32_t pairs) const;
  const engine::Buffer& at(engine::BufferId id) const { return memory[id]; }
  shaders::IteratePush push(int level, uint32_t iterations, uint32_t flags) const;
  void iterate(engine::Recorder& recorder, int level, uint32_t pairs, uint32_t iterations, uint32_t flags) const;
};

/// Features as the device has them, those that take no part with an inverse depth of 0.
Features unpack_features(const shaders::FeatureInfo* features, uint32_t count);

/// Mapped states, trace or kept features, wherever the host can read them.
const shaders::PairState* read_states(const RunBuffers& ids, const engine::Workspace& run);
const shaders::FeatureInfo* read_features(const RunBuffers& ids, const engine::Workspace& run);
const shaders::TraceEntry* read_trace(const RunBuffers& ids, const engine::Workspace& run);

NormalSums unpack_sums(const float* sums);
Agreement unpack_agreement(const float* sums);
SE3 unpack_pose(const float* pose);
void pack_pose(const SE3& T, float* pose);
shaders::PairInfo pack_pair(const SE3& T_10, const PosePrior* prior, int reference, uint32_t target, bool enabled,
                            const AlignerOptions& options);

/// A pair that was submitted or recorded, and what the verdict on it needs: its slot may be set anew before anybody reads it.
struct Awaited {
  bool enough;
  SE3 T_10;
  Camera camera;
  double mean_inverse_depth;
  std::optional<PosePrior> prior;
  std::vector<FeatureCheck> checks;
  uint32_t chosen = 0;  // features that the device chose: what the four before this say is not known yet

  /// Precondition: chosen; what the device chose.
  void take(const shaders::FeatureInfo* features, const AlignerOptions& options);
  /// What the device solver left of it, judged like any other.
  Alignment conclude(const shaders::PairState& state, const shaders::TraceEntry* trace, const AlignerOptions& options) const;
};

}  // namespace iclk::internal
