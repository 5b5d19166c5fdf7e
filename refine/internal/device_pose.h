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
  std::optional<engine::BufferId> aligned_read, refined_read;  // if device memory is not mapped
};

/// Pose refinement on the device: the shaders `shaders/refine/refine_*.comp`. Records the steps between the rounds of feature
/// alignment, before and after them.
class DevicePose {
 public:
  DevicePose(const std::shared_ptr<const engine::Context>& context, const RefinerOptions& options, int width, int height);

  /// Makes the tasks of the first round from ICLK's `results` (shaders::ResultInfo).
  void start(engine::Recorder& recorder, const PoseBuffers& ids, const engine::Workspace& memory, const engine::Buffer& results,
             uint32_t pairs) const;
  /// Computes poses from the aligned features, and makes the tasks of the next round.
  void round(engine::Recorder& recorder, const PoseBuffers& ids, const engine::Workspace& memory,
             const engine::Buffer& references, uint32_t pairs) const;
  /// After the last round, if RefinerOptions::rolling_shutter: finds proven turns and corrects the poses for them.
  void unbend(engine::Recorder& recorder, const PoseBuffers& ids, const engine::Workspace& memory,
              const engine::Buffer& references, uint32_t pairs) const;
  /// Judges the poses. `rivals`: unconfirmed starts are not kept, and the last round's pose is kept for every verdict.
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
