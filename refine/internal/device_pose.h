#pragma once
#include <memory>
#include <optional>

#include <iclk/engine/compute/kernel.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/engine/compute/recorder.h>
#include <iclk/refine/refiner.h>
#include <iclk/shaders/refine/refine.h>
#include <iclk/shaders/shared.h>

namespace iclk::internal {

/// Buffers of the refinement of up to `pairs` poses, of `features` features each.
struct PoseBuffers {
  PoseBuffers(int pairs, int features, bool unified_memory);
  engine::MemoryPlan plan;
  engine::BufferId pairs, features, tasks, aligned, observations, states, turns, refined;
  std::optional<engine::BufferId> aligned_read, refined_read;  // where device memory cannot be mapped
};

/// Pose refinement on the device: shaders/refine/refine_*.comp. Records between and around the rounds of feature alignment.
class DevicePose {
 public:
  DevicePose(const std::shared_ptr<const engine::Context>& context, const RefinerOptions& options, int width, int height);

  /// Tasks of the first round from ICLK's `results` (shaders::ResultInfo).
  void start(engine::Recorder& recorder, const PoseBuffers& ids, const engine::Workspace& memory, const engine::Buffer& results,
             uint32_t pairs) const;
  /// Poses of what feature alignment has found, and the tasks of the next round.
  void round(engine::Recorder& recorder, const PoseBuffers& ids, const engine::Workspace& memory,
             const engine::Buffer& references, uint32_t pairs) const;
  /// After the last round, where RefinerOptions::rolling_shutter: the turns that features prove, and the poses without them.
  void unbend(engine::Recorder& recorder, const PoseBuffers& ids, const engine::Workspace& memory,
              const engine::Buffer& references, uint32_t pairs) const;
  /// `rivals`: no start stands unconfirmed, and the last round's pose is kept whatever the verdict.
  void verdict(engine::Recorder& recorder, const PoseBuffers& ids, const engine::Workspace& memory,
               const engine::Buffer& references, uint32_t pairs, bool rivals = false) const;

  void add_to(engine::ArenaSize& size) const;

 private:
  void estimate(engine::Recorder& recorder, const engine::Kernel& kernel, const PoseBuffers& ids,
                const engine::Workspace& memory, const engine::Buffer& references, uint32_t pairs) const;

  shaders::RefinePush push_{};
  engine::Kernel start_, consensus_, pose_, verdict_;
  std::optional<engine::Kernel> turn_;
};

}  // namespace iclk::internal
