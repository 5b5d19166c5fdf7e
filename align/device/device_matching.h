#pragma once
#include <iclk/align/device/target_masks.h>
#include <iclk/align/plan/layout.h>
#include <iclk/align/search/matching.h>
#include <iclk/engine/compute/kernel.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/engine/compute/recorder.h>

namespace iclk::internal {

/// The search by matching on a device: align/search/matching.h in shaders.
class DeviceMatching {
 public:
  /// Arithmetic only: adds its buffers to `memory`, unless MatchLayout::enabled is false.
  DeviceMatching(const Plan& plan, const AlignerOptions& options, const Layout& layout, const WorkgroupSizes& sizes, int batch,
                 engine::MemoryPlan& memory);
  /// Call it once, before recording.
  void load(const std::shared_ptr<const engine::Context>& context);
  explicit operator bool() const { return match_.enabled; }
  void add_to(engine::ArenaSize& size) const;

  /// Records grey maps and descriptors of references [first, first + count). Precondition: their pixels and features are set.
  void describe(engine::Recorder& recorder, const engine::Workspace& memory, const engine::Buffer& pixels0,
                const engine::Buffer& references, const engine::Buffer& features, uint32_t first, uint32_t count) const;

  struct Pairs {
    const engine::Buffer &pixels1, &references, &features, &pairs;
    const TargetMasks& masks;  // false: no pixel is hidden
    uint32_t count, most_features;
  };
  /// Records the search; sets pose and first level in the PairInfo of each pair with a start.
  void find(engine::Recorder& recorder, const engine::Workspace& memory, const Pairs& pairs) const;

  // For the search for rivals of an answer: refine/internal/device_rivals.h.
  const MatchLayout& layout() const { return match_; }
  const engine::Buffer& reference_maps(const engine::Workspace& memory) const { return memory[grey0_]; }
  const engine::Buffer& target_descriptors(const engine::Workspace& memory) const { return memory[descriptors1_]; }
  /// Scores given descriptors of pairs, instead of upright ones, at all places: one MatchInfo per cell of
  /// ICLK_ELSEWHERE_CELL^2 places.
  void score_cells(engine::Recorder& recorder, const engine::Workspace& memory, const engine::Buffer& references,
                   const engine::Buffer& pairs, const engine::Buffer& descriptors, const engine::Buffer& cells,
                   uint32_t count) const;
  /// Finds the pose with the most agreeing correspondences, of up to `most` per pair. It is in PairInfo, if `matched`.
  void agree(engine::Recorder& recorder, const engine::Buffer& references, const engine::Buffer& pairs,
             const engine::Buffer& correspondences, const engine::Buffer& hypotheses, uint32_t most, uint32_t count) const;
  void add_elsewhere_to(engine::ArenaSize& size, uint32_t poses) const;

 private:
  void grey(engine::Recorder& recorder, const engine::Buffer& pixels, const engine::Buffer& maps, uint32_t first,
            uint32_t count) const;
  /// Matches upright patches, or all rolls for the pairs that are not matched yet.
  void round(engine::Recorder& recorder, const engine::Workspace& memory, const Pairs& pairs, bool upright) const;

  MatchLayout match_;
  shaders::MatchPush push_{};
  PixelFormat format_;
  WorkgroupSizes sizes_;
  engine::BufferId grey0_{}, grey1_{}, descriptors0_{}, descriptors1_{}, matches_{}, correspondences_{}, hypotheses_{};
  engine::Kernel grey_kernel_, describe_reference_, describe_target_, correspond_, hypothesise_, pose_;
  engine::Kernel match_kernels_[2];  // all rolls, upright
  engine::Kernel cells_kernel_;      // deferred
};

}  // namespace iclk::internal
