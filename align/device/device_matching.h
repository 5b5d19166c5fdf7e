#pragma once
#include <iclk/align/plan/layout.h>
#include <iclk/align/device/target_masks.h>
#include <iclk/align/search/matching.h>
#include <iclk/engine/compute/kernel.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/engine/compute/recorder.h>

namespace iclk::internal {

/// Starts by matching on a device: align/search/matching.h in shaders.
class DeviceMatching {
 public:
  /// Arithmetic only: adds its buffers to `memory`; nothing where MatchLayout::enabled is false.
  DeviceMatching(const Plan& plan, const AlignerOptions& options, const Layout& layout, const WorkgroupSizes& sizes, int batch,
                 engine::MemoryPlan& memory);
  /// Once, before anything is recorded.
  void load(const std::shared_ptr<const engine::Context>& context);
  explicit operator bool() const { return match_.enabled; }
  void add_to(engine::ArenaSize& size) const;

  /// Grey maps and descriptors of references [first, first + count) whose pixels and features are there.
  void describe(engine::Recorder& recorder, const engine::Workspace& memory, const engine::Buffer& pixels0,
                const engine::Buffer& references, const engine::Buffer& features, uint32_t first, uint32_t count) const;

  struct Pairs {
    const engine::Buffer &pixels1, &references, &features, &pairs;
    const TargetMasks& masks;  // false: no pixel is hidden
    uint32_t count, most_features;
  };
  /// Starts of pairs that matching finds: their PairInfo's pose and first level.
  void find(engine::Recorder& recorder, const engine::Workspace& memory, const Pairs& pairs) const;

  // What else a target shows than an answer: refine/internal/device_rivals.h asks.
  const MatchLayout& layout() const { return match_; }
  const engine::Buffer& reference_maps(const engine::Workspace& memory) const { return memory[grey0_]; }
  const engine::Buffer& target_descriptors(const engine::Workspace& memory) const { return memory[descriptors1_]; }
  /// Descriptors of pairs, in the places of upright ones, against all places: MatchInfo a cell of ICLK_ELSEWHERE_CELL squared.
  void score_cells(engine::Recorder& recorder, const engine::Workspace& memory, const engine::Buffer& references,
                   const engine::Buffer& pairs, const engine::Buffer& descriptors, const engine::Buffer& cells,
                   uint32_t count) const;
  /// The pose on which most of up to `most` correspondences a pair agree: PairInfo's, if `matched`.
  void agree(engine::Recorder& recorder, const engine::Buffer& references, const engine::Buffer& pairs,
             const engine::Buffer& correspondences, const engine::Buffer& hypotheses, uint32_t most, uint32_t count) const;
  void add_elsewhere_to(engine::ArenaSize& size, uint32_t poses) const;

 private:
  void grey(engine::Recorder& recorder, const engine::Buffer& pixels, const engine::Buffer& maps, uint32_t first,
            uint32_t count) const;
  /// Looks for patches that are not rolled, or for all rolls for those pairs that are not matched yet.
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
