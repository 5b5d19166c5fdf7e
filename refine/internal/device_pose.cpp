#include <iclk/refine/internal/device_pose.h>

#include "refine_consensus.comp.spv.h"
#include "refine_pose.comp.spv.h"
#include "refine_start.comp.spv.h"
#include "refine_turn.comp.spv.h"
#include "refine_verdict.comp.spv.h"

namespace iclk::internal {

using engine::BufferUse;
using engine::MemoryKind;

PoseBuffers::PoseBuffers(int max_pairs, int max_features, bool unified_memory) {
  const auto n = static_cast<uint64_t>(max_pairs), all = n * static_cast<uint64_t>(max_features);
  const auto storage = BufferUse::storage;
  pairs = plan.add("pairs to refine", sizeof(shaders::RefinePair) * n, MemoryKind::table, storage);
  features = plan.add("features to refine", sizeof(shaders::FeatureInfo) * all, MemoryKind::table, storage);
  tasks = plan.add("feature tasks", sizeof(shaders::FeatureTask) * n, MemoryKind::device, storage);
  aligned = plan.add("aligned features", sizeof(shaders::AlignedInfo) * all, MemoryKind::device, storage);
  observations = plan.add("observations", sizeof(shaders::ObservationInfo) * all, MemoryKind::device, storage);
  states = plan.add("refinement states", sizeof(shaders::RefineState) * n, MemoryKind::device, storage);
  turns = plan.add("turns", sizeof(shaders::TurnInfo) * n, MemoryKind::device, storage);
  refined = plan.add("refined", sizeof(shaders::RefinedInfo) * n, MemoryKind::device, storage);
  if (unified_memory) return;
  aligned_read =
      plan.add("aligned features read back", sizeof(shaders::AlignedInfo) * all, MemoryKind::readback, BufferUse::transfer);
  refined_read = plan.add("refined read back", sizeof(shaders::RefinedInfo) * n, MemoryKind::readback, BufferUse::transfer);
}

DevicePose::DevicePose(const std::shared_ptr<const engine::Context>& context, const RefinerOptions& options, int width,
                       int height) {
  using enum engine::BindingKind;
  constexpr uint32_t bytes = sizeof(shaders::RefinePush);
  start_ = engine::Kernel(context, {"refine_start",
                                    refine_start_comp_spv,
                                    {storage_read, storage_read, storage_write, storage_write, storage_write, storage_write},
                                    bytes,
                                    {}});
  consensus_ = engine::Kernel(context, {"refine_consensus",
                                        refine_consensus_comp_spv,
                                        {storage_read, storage_read, storage_read, storage_read, storage_read_write,
                                         storage_read_write, storage_read, storage_read},
                                        bytes,
                                        {}});
  // References, pairs, features, aligned features, observations, states, turns; tasks.
  pose_ = engine::Kernel(context, {"refine_pose",
                                   refine_pose_comp_spv,
                                   {storage_read, storage_read, storage_read, storage_read, storage_read_write,
                                    storage_read_write, storage_read, storage_read_write},
                                   bytes,
                                   {}});
  if (options.rolling_shutter)
    turn_ = engine::Kernel(context, {"refine_turn",
                                     refine_turn_comp_spv,
                                     {storage_read, storage_read, storage_read, storage_read, storage_read_write, storage_read,
                                      storage_read_write, storage_read_write},
                                     bytes,
                                     {}});
  verdict_ = engine::Kernel(context, {"refine_verdict",
                                      refine_verdict_comp_spv,
                                      {storage_read, storage_read, storage_read, storage_read, storage_read_write,
                                       storage_read_write, storage_read, storage_read_write},
                                      bytes,
                                      {}});
  const PoseOptions& pose = options.pose;
  push_.sigma = static_cast<float>(pose.sigma);
  push_.min_sigma = static_cast<float>(pose.min_sigma);
  push_.max_sigma = static_cast<float>(pose.max_sigma);
  push_.max_depth_sigma = static_cast<float>(pose.max_depth_sigma);
  push_.camera_sigma = static_cast<float>(pose.camera_sigma.value_or(-1));
  push_.cauchy_scale = static_cast<float>(pose.cauchy_scale);
  push_.inlier_distance = static_cast<float>(pose.inlier_distance);
  push_.pose_inlier_share = static_cast<float>(pose.min_inlier_share);
  push_.iterations = static_cast<uint32_t>(pose.iterations);
  push_.min_features = static_cast<uint32_t>(pose.min_features);
  push_.round_tolerance = static_cast<float>(options.round_tolerance);
  push_.min_inliers = static_cast<uint32_t>(options.min_inliers);
  push_.min_inlier_share = static_cast<float>(options.min_inlier_share);
  push_.min_clear_share = static_cast<float>(options.min_clear_share);
  push_.max_correction = static_cast<float>(options.max_correction);
  push_.keep_unconfirmed = options.keep_unconfirmed;
  push_.width = static_cast<uint32_t>(width);
  push_.height = static_cast<uint32_t>(height);
}

void DevicePose::start(engine::Recorder& recorder, const PoseBuffers& ids, const engine::Workspace& memory,
                       const engine::Buffer& results, uint32_t pairs) const {
  shaders::RefinePush push = push_;
  push.pairs = pairs;
  recorder.stage("pose");
  recorder.dispatch(
      start_, {&memory[ids.pairs], &results, &memory[ids.tasks], &memory[ids.states], &memory[ids.turns], &memory[ids.refined]},
      push, {engine::groups_for(pairs, ICLK_REFINE_GROUP), 1, 1});
}

void DevicePose::round(engine::Recorder& recorder, const PoseBuffers& ids, const engine::Workspace& memory,
                       const engine::Buffer& references, uint32_t pairs) const {
  recorder.stage("pose");
  estimate(recorder, consensus_, ids, memory, references, pairs);
  estimate(recorder, pose_, ids, memory, references, pairs);
}

void DevicePose::unbend(engine::Recorder& recorder, const PoseBuffers& ids, const engine::Workspace& memory,
                        const engine::Buffer& references, uint32_t pairs) const {
  if (!turn_) return;
  recorder.stage("pose");
  estimate(recorder, *turn_, ids, memory, references, pairs);
  estimate(recorder, consensus_, ids, memory, references, pairs);
  estimate(recorder, pose_, ids, memory, references, pairs);
}

void DevicePose::estimate(engine::Recorder& recorder, const engine::Kernel& kernel, const PoseBuffers& ids,
                          const engine::Workspace& memory, const engine::Buffer& references, uint32_t pairs) const {
  recorder.dispatch(kernel,
                    {&references, &memory[ids.pairs], &memory[ids.features], &memory[ids.aligned], &memory[ids.observations],
                     &memory[ids.states], &memory[ids.turns], &memory[ids.tasks]},
                    push_, {pairs, 1, 1});
}

void DevicePose::verdict(engine::Recorder& recorder, const PoseBuffers& ids, const engine::Workspace& memory,
                         const engine::Buffer& references, uint32_t pairs, bool rivals) const {
  shaders::RefinePush push = push_;
  push.rivals = rivals;
  push.keep_unconfirmed = push.keep_unconfirmed && !rivals;
  recorder.stage("verdict");
  recorder.dispatch(verdict_,
                    {&references, &memory[ids.pairs], &memory[ids.features], &memory[ids.aligned], &memory[ids.observations],
                     &memory[ids.states], &memory[ids.turns], &memory[ids.refined]},
                    push, {pairs, 1, 1});
}

void DevicePose::add_to(engine::ArenaSize& size) const {
  size.add(start_);
  size.add(consensus_);
  size.add(pose_);
  if (turn_) size.add(*turn_);
  size.add(verdict_);
}

}  // namespace iclk::internal
