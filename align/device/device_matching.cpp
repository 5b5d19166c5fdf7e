#include <iclk/align/device/device_matching.h>

#include <algorithm>

#include <iclk/align/device/kernels.h>

#include "correspond.comp.spv.h"
#include "describe_reference.comp.spv.h"
#include "describe_target.comp.spv.h"
#include "hypothesise.comp.spv.h"
#include "match.comp.spv.h"
#include "match_grey.comp.spv.h"
#include "match_pose.comp.spv.h"

namespace iclk::internal {

using engine::groups_for;

DeviceMatching::DeviceMatching(const Plan& plan, const AlignerOptions& options, const Layout& layout,
                               const WorkgroupSizes& sizes, int batch, engine::MemoryPlan& memory)
    : match_(plan, options), format_(plan.format), sizes_(sizes) {
  if (!match_.enabled) return;
  push_.scale = static_cast<uint32_t>(match_.scale);
  push_.width = static_cast<uint32_t>(match_.width);
  push_.height = static_cast<uint32_t>(match_.height);
  push_.features = static_cast<uint32_t>(match_.features);
  push_.max_features = static_cast<uint32_t>(plan.max_features);
  push_.row_pixels = layout.row_pixels();
  push_.pixel_words = layout.pixel_words;
  push_.first_level = static_cast<uint32_t>(match_.first_level);
  const auto references = static_cast<uint64_t>(plan.max_references), pairs = static_cast<uint64_t>(batch);
  const auto features = static_cast<uint64_t>(match_.features);
  const auto texels = engine::BufferUse::storage | engine::BufferUse::texel;
  const auto device = engine::MemoryKind::device;
  const uint64_t map = 4ull * push_.width * push_.height, descriptor = 16 * ICLK_MATCH_TEXELS;
  constexpr VkFormat vec4 = VK_FORMAT_R32G32B32A32_SFLOAT;
  grey0_ = memory.add("reference match maps", map * references, device, texels, VK_FORMAT_R32_SFLOAT);
  grey1_ = memory.add("target match maps", map * pairs, device, texels, VK_FORMAT_R32_SFLOAT);
  descriptors0_ =
      memory.add("reference descriptors", descriptor * ICLK_MATCH_ROLLS * features * references, device, texels, vec4);
  descriptors1_ =
      memory.add("target descriptors", descriptor * static_cast<uint64_t>(match_.places()) * pairs, device, texels, vec4);
  matches_ = memory.add("matches", sizeof(shaders::MatchInfo) * features * static_cast<uint64_t>(match_.tiles()) * pairs,
                        device, engine::BufferUse::storage);
  correspondences_ = memory.add("correspondences", 32 * (features + 1) * pairs, device, texels, vec4);
  hypotheses_ = memory.add("hypotheses", 64ull * ICLK_MATCH_HYPOTHESES * pairs, device, engine::BufferUse::storage);
}

void DeviceMatching::load(const std::shared_ptr<const engine::Context>& context) {
  if (!match_.enabled) return;
  using enum engine::BindingKind;
  constexpr uint32_t push = sizeof(shaders::MatchPush);
  engine::KernelBatch batch(context);
  batch.add(grey_kernel_,
            {"match_grey", match_grey_comp_spv, {texel_read, storage_write}, push, {sizes_.map, shader_format(format_)}});
  batch.add(describe_reference_, {"describe_reference",
                                  describe_reference_comp_spv,
                                  {texel_read, storage_read, storage_read, storage_write},
                                  push,
                                  {sizes_.map}});
  batch.add(describe_target_, {"describe_target", describe_target_comp_spv, {texel_read, storage_write}, push, {sizes_.map}});
  for (const uint32_t upright : {0u, 1u})
    batch.add(match_kernels_[upright], {"match",
                                        match_comp_spv,
                                        {storage_read, storage_read, texel_read, texel_read, storage_write},
                                        push,
                                        {std::min(sizes_.iterate, 64u), upright}});
  batch.add(correspond_, {"correspond",
                          correspond_comp_spv,
                          {storage_read, storage_read, storage_read, storage_read, texel_read, texel_read, storage_write},
                          push,
                          {std::min(sizes_.iterate, 64u)}});
  batch.add(hypothesise_, {"hypothesise",
                           hypothesise_comp_spv,
                           {storage_read, storage_read, texel_read, storage_write},
                           push,
                           {std::min(sizes_.iterate, 64u)}});
  batch.add(pose_, {"match_pose", match_pose_comp_spv, {storage_read, storage_read_write, texel_read, storage_read}, push, {}});
  batch.make();
  cells_kernel_ = engine::Kernel::deferred(context, {"match",
                                                     match_comp_spv,
                                                     {storage_read, storage_read, texel_read, texel_read, storage_write},
                                                     push,
                                                     {std::min(sizes_.iterate, 64u), 1, ICLK_ELSEWHERE_CELL, 1}});
}

void DeviceMatching::add_to(engine::ArenaSize& size) const {
  if (!match_.enabled) return;
  size.add(grey_kernel_, 2);
  for (const engine::Kernel* kernel : {&describe_reference_, &describe_target_, &match_kernels_[0], &match_kernels_[1]})
    size.add(*kernel);
  for (const engine::Kernel* kernel : {&correspond_, &hypothesise_, &pose_}) size.add(*kernel, 2);
}

void DeviceMatching::grey(engine::Recorder& recorder, const engine::Buffer& pixels, const engine::Buffer& maps, uint32_t first,
                          uint32_t count) const {
  shaders::MatchPush push = push_;
  push.first_reference = first;
  recorder.dispatch(grey_kernel_, {&pixels, &maps}, push, {groups_for(push.width * push.height, sizes_.map), 1, count});
}

void DeviceMatching::describe(engine::Recorder& recorder, const engine::Workspace& memory, const engine::Buffer& pixels0,
                              const engine::Buffer& references, const engine::Buffer& features, uint32_t first,
                              uint32_t count) const {
  recorder.stage("describe");
  grey(recorder, pixels0, memory[grey0_], first, count);
  shaders::MatchPush push = push_;
  push.first_reference = first;
  recorder.dispatch(describe_reference_, {&memory[grey0_], &references, &features, &memory[descriptors0_]}, push,
                    {groups_for(push.features * ICLK_MATCH_ROLLS, sizes_.map), 1, count});
}

void DeviceMatching::find(engine::Recorder& recorder, const engine::Workspace& memory, const Pairs& pairs) const {
  const uint32_t count = pairs.count;
  recorder.stage("describe");
  grey(recorder, pairs.pixels1, memory[grey1_], 0, count);
  if (pairs.masks) pairs.masks.record(recorder, pairs.pixels1, memory[grey1_], push_.width, push_.height, push_.scale, count);
  recorder.dispatch(describe_target_, {&memory[grey1_], &memory[descriptors1_]}, push_,
                    {groups_for(static_cast<uint32_t>(match_.places()), sizes_.map), 1, count});
  round(recorder, memory, pairs, true);
  round(recorder, memory, pairs, false);
}

void DeviceMatching::round(engine::Recorder& recorder, const engine::Workspace& memory, const Pairs& pairs,
                           bool upright) const {
  const uint32_t group = std::min(sizes_.iterate, 64u), count = pairs.count;
  shaders::MatchPush push = push_;
  push.first_roll = upright ? ICLK_MATCH_ROLLS / 2 : 0;
  push.hypotheses = upright ? ICLK_MATCH_UPRIGHT_HYPOTHESES : ICLK_MATCH_HYPOTHESES;
  push.rolls = upright ? 1 : ICLK_MATCH_ROLLS;
  push.sought = std::min(push.features, upright ? ICLK_MATCH_UPRIGHT_FEATURES : push.features);
  push.share = static_cast<float>(upright ? ICLK_MATCH_UPRIGHT_SHARE : ICLK_MATCH_SHARE);
  const uint32_t features = std::min(pairs.most_features, push.sought);
  recorder.stage("match");
  recorder.dispatch(match_kernels_[upright],
                    {&pairs.references, &pairs.pairs, &memory[descriptors0_], &memory[descriptors1_], &memory[matches_]}, push,
                    {groups_for(upright ? groups_for(features, ICLK_MATCH_ROLLS) : features, group),
                     static_cast<uint32_t>(match_.tiles()), count});
  recorder.dispatch(correspond_,
                    {&pairs.references, &pairs.pairs, &pairs.features, &memory[matches_], &memory[descriptors0_],
                     &memory[descriptors1_], &memory[correspondences_]},
                    push, {1, 1, count});
  recorder.stage("match_pose");
  recorder.dispatch(hypothesise_, {&pairs.references, &pairs.pairs, &memory[correspondences_], &memory[hypotheses_]}, push,
                    {groups_for(push.hypotheses, group), 1, count});
  recorder.dispatch(pose_, {&pairs.references, &pairs.pairs, &memory[correspondences_], &memory[hypotheses_]}, push,
                    {1, 1, count});
}

void DeviceMatching::score_cells(engine::Recorder& recorder, const engine::Workspace& memory, const engine::Buffer& references,
                                 const engine::Buffer& pairs, const engine::Buffer& descriptors, const engine::Buffer& cells,
                                 uint32_t count) const {
  const uint32_t group = std::min(sizes_.iterate, 64u);
  shaders::MatchPush push = push_;
  push.rolls = 1;
  push.sought = push.features;
  recorder.dispatch(
      cells_kernel_, {&references, &pairs, &descriptors, &memory[descriptors1_], &cells}, push,
      {groups_for(groups_for(push.features, ICLK_MATCH_ROLLS), group), static_cast<uint32_t>(match_.tiles()), count});
}

void DeviceMatching::agree(engine::Recorder& recorder, const engine::Buffer& references, const engine::Buffer& pairs,
                           const engine::Buffer& correspondences, const engine::Buffer& hypotheses, uint32_t most,
                           uint32_t count) const {
  shaders::MatchPush push = push_;
  push.features = most;
  push.hypotheses = ICLK_MATCH_HYPOTHESES;
  push.rolls = 1;
  push.share = 0;
  recorder.dispatch(hypothesise_, {&references, &pairs, &correspondences, &hypotheses}, push,
                    {groups_for(push.hypotheses, std::min(sizes_.iterate, 64u)), 1, count});
  recorder.dispatch(pose_, {&references, &pairs, &correspondences, &hypotheses}, push, {1, 1, count});
}

void DeviceMatching::add_elsewhere_to(engine::ArenaSize& size, uint32_t poses) const {
  size.add(cells_kernel_);
  size.add(hypothesise_, poses);
  size.add(pose_, poses);
}

}  // namespace iclk::internal
