#pragma once
#include <memory>

#include <iclk/align/device/device_matching.h>
#include <iclk/align/device/parts.h>
#include <iclk/engine/compute/kernel.h>
#include <iclk/refine/internal/device_pose.h>
#include <iclk/refine/refiner.h>

namespace iclk::internal {

/// Buffers of the search for rivals of up to `pairs` answers.
struct RivalBuffers {
  RivalBuffers(int pairs, const MatchLayout& layout);
  engine::MemoryPlan plan;
  engine::BufferId questions, sought, descriptors, cells, correspondences, hypotheses, results;
};

/// Searches for rivals of answers on the device: refine/internal/rivals.h in shaders. It uses the data of the last batch of a
/// DeviceAligner with a search by matching.
class DeviceRivals {
 public:
  DeviceRivals(const DeviceAligner& aligner, const RefinerOptions& options);
  const MatchLayout& layout() const { return matching_.layout(); }

  /// Finds poses from places that look like features elsewhere. Results are ResultInfo, rival j of pair i at j * pairs + i.
  void find(engine::Recorder& recorder, const RivalBuffers& ids, const engine::Workspace& memory,
            const PoseBuffers& answers_ids, const engine::Workspace& answers, const engine::Buffer& references,
            uint32_t pairs) const;
  /// Compares every answer with its rivals.
  void weigh(engine::Recorder& recorder, const RivalBuffers& ids, const engine::Workspace& memory,
             const PoseBuffers& answers_ids, const engine::Workspace& answers, const PoseBuffers& rivals_ids,
             const engine::Workspace& rivals, const engine::Buffer& references, uint32_t pairs) const;
  void add_to(engine::ArenaSize& size) const;

 private:
  const DeviceMatching& matching_;
  const engine::Workspace& matched_;
  shaders::RivalPush push_{};
  engine::Kernel ask_, describe_, places_, take_, weigh_;
};

}  // namespace iclk::internal
