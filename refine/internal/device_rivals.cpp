#include <iclk/refine/internal/device_rivals.h>

#include "rivals_ask.comp.spv.h"
#include "rivals_describe.comp.spv.h"
#include "rivals_places.comp.spv.h"
#include "rivals_take.comp.spv.h"
#include "rivals_weigh.comp.spv.h"

namespace iclk::internal {

using engine::BufferUse;
using engine::MemoryKind;

RivalBuffers::RivalBuffers(int max_pairs, const MatchLayout& layout) {
  const auto n = static_cast<uint64_t>(max_pairs), features = static_cast<uint64_t>(layout.features);
  const auto of_cells = [](int places) -> uint64_t {
    return engine::groups_for(static_cast<uint32_t>(places), ICLK_ELSEWHERE_CELL);
  };
  const auto storage = BufferUse::storage, texels = BufferUse::storage | BufferUse::texel;
  constexpr auto device = MemoryKind::device;
  constexpr VkFormat vec4 = VK_FORMAT_R32G32B32A32_SFLOAT;
  questions = plan.add("questions", sizeof(shaders::PairInfo) * n, device, storage);
  sought = plan.add("sought features", 16 * ICLK_ELSEWHERE_STRIDE * features * n, device, storage);
  descriptors = plan.add("warped descriptors", 16 * ICLK_MATCH_TEXELS * ICLK_MATCH_ROLLS * features * n, device, texels, vec4);
  const uint64_t cells_n = of_cells(layout.places_x) * of_cells(layout.places_y) * features * n;
  cells = plan.add("scores of cells", sizeof(shaders::MatchInfo) * cells_n, device, storage);
  correspondences = plan.add("places elsewhere", 32 * (ICLK_ELSEWHERE_PLACES * features + 1) * n, device, texels, vec4);
  hypotheses = plan.add("poses elsewhere", 64ull * ICLK_MATCH_HYPOTHESES * n, device, storage);
  results = plan.add("rivals found", sizeof(shaders::ResultInfo) * ICLK_RIVALS * n, device, storage);
}

DeviceRivals::DeviceRivals(const DeviceAligner& aligner, const RefinerOptions& options)
    : matching_(DeviceParts::matching(aligner)), matched_(DeviceParts::memory(aligner)) {
  using enum engine::BindingKind;
  constexpr uint32_t bytes = sizeof(shaders::RivalPush);
  const auto& context = aligner.context();
  ask_ = engine::Kernel(
      context, {"rivals_ask",
                rivals_ask_comp_spv,
                {storage_read, storage_read, storage_read, storage_read, storage_read, storage_read_write, storage_read_write},
                bytes,
                {}});
  describe_ = engine::Kernel(context, {"rivals_describe",
                                       rivals_describe_comp_spv,
                                       {texel_read, storage_read, storage_read, storage_read, storage_write},
                                       bytes,
                                       {}});
  places_ = engine::Kernel(
      context, {"rivals_places",
                rivals_places_comp_spv,
                {storage_read, storage_read_write, storage_read_write, storage_read, texel_read, texel_read, storage_write},
                bytes,
                {}});
  take_ = engine::Kernel(
      context,
      {"rivals_take", rivals_take_comp_spv, {storage_read, storage_read_write, storage_read_write, storage_write}, bytes, {}});
  weigh_ = engine::Kernel(context, {"rivals_weigh",
                                    rivals_weigh_comp_spv,
                                    {storage_read, storage_read, storage_read, storage_read_write, storage_read_write,
                                     storage_read, storage_read, storage_read},
                                    bytes,
                                    {}});
  const MatchLayout& match = layout();
  push_.max_features = static_cast<uint32_t>(aligner.plan().max_features);
  push_.features = static_cast<uint32_t>(match.features);
  push_.scale = static_cast<uint32_t>(match.scale);
  push_.width = static_cast<uint32_t>(match.width);
  push_.height = static_cast<uint32_t>(match.height);
  push_.inlier_distance = static_cast<float>(options.pose.inlier_distance);
  push_.max_rival_share = static_cast<float>(options.max_rival_share);
  push_.min_inliers = static_cast<uint32_t>(options.min_inliers);
}

void DeviceRivals::find(engine::Recorder& recorder, const RivalBuffers& ids, const engine::Workspace& memory,
                        const PoseBuffers& answers_ids, const engine::Workspace& answers, const engine::Buffer& references,
                        uint32_t pairs) const {
  shaders::RivalPush push = push_;
  push.pairs = pairs;
  recorder.stage("rivals");
  recorder.dispatch(ask_,
                    {&references, &answers[answers_ids.pairs], &answers[answers_ids.features], &answers[answers_ids.aligned],
                     &answers[answers_ids.refined], &memory[ids.questions], &memory[ids.sought]},
                    push, {pairs, 1, 1});
  recorder.dispatch(
      describe_,
      {&matching_.reference_maps(matched_), &memory[ids.questions], &references, &memory[ids.sought], &memory[ids.descriptors]},
      push, {engine::groups_for(push.features, ICLK_REFINE_GROUP), 1, pairs});
  matching_.score_cells(recorder, matched_, references, memory[ids.questions], memory[ids.descriptors], memory[ids.cells],
                        pairs);
  recorder.dispatch(places_,
                    {&references, &memory[ids.questions], &memory[ids.sought], &memory[ids.cells], &memory[ids.descriptors],
                     &matching_.target_descriptors(matched_), &memory[ids.correspondences]},
                    push, {pairs, 1, 1});
  for (; push.rival < ICLK_RIVALS; ++push.rival) {
    matching_.agree(recorder, references, memory[ids.questions], memory[ids.correspondences], memory[ids.hypotheses],
                    ICLK_ELSEWHERE_PLACES * push.features, pairs);
    recorder.dispatch(take_, {&references, &memory[ids.questions], &memory[ids.correspondences], &memory[ids.results]}, push,
                      {pairs, 1, 1});
  }
}

void DeviceRivals::weigh(engine::Recorder& recorder, const RivalBuffers& ids, const engine::Workspace& memory,
                         const PoseBuffers& answers_ids, const engine::Workspace& answers, const PoseBuffers& rivals_ids,
                         const engine::Workspace& rivals, const engine::Buffer& references, uint32_t pairs) const {
  shaders::RivalPush push = push_;
  push.pairs = pairs;
  recorder.stage("rivals");
  recorder.dispatch(
      weigh_,
      {&references, &answers[answers_ids.pairs], &answers[answers_ids.features], &answers[answers_ids.aligned],
       &answers[answers_ids.refined], &rivals[rivals_ids.aligned], &rivals[rivals_ids.refined], &memory[ids.questions]},
      push, {pairs, 1, 1});
}

void DeviceRivals::add_to(engine::ArenaSize& size) const {
  for (const engine::Kernel* kernel : {&ask_, &describe_, &places_, &weigh_}) size.add(*kernel);
  size.add(take_, ICLK_RIVALS);
  matching_.add_elsewhere_to(size, ICLK_RIVALS);
}

}  // namespace iclk::internal
