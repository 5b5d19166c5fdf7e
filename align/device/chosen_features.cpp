// The choice of features by the device, in a depth image of the application: Plan::choose_features.
#include <cmath>

#include <iclk/align/device/impl.h>

namespace iclk {

using engine::groups_for;
using engine::Recorder;

DeviceDepth DeviceDepth::projected(const DeviceImageView& view, float z0, float z1) {
  // The inverse depth is linear in the value between the two.
  return {view, true, 1 / z1 - 1 / z0, 1 / z0, z1 > z0 ? 1.0f : 0.0f};
}

void DeviceAligner::Impl::set_chosen_slot(int slot, const Camera& camera) {
  set_slot(slot, camera, {}, 0, {});
  const auto s = static_cast<size_t>(slot);
  const internal::Cells cells(plan);
  auto* info = memory[ids.references].as<shaders::ReferenceInfo>() + slot;
  info->feature_count = cells.count();
  info->tile_count = tiles.build(cells, memory[ids.tiles].as<shaders::MaskTile>() + s * layout.tile_stride,
                                 memory[ids.entries].as<uint32_t>() + s * layout.entry_stride);
  slots[s].chosen = cells.count();
  slots[s].enough = true;  // checked on the device
}

void DeviceAligner::Impl::choose_features(Recorder& recorder, int slot, const DeviceDepth& depth) const {
  const internal::Cells cells(plan);
  const auto s = static_cast<uint32_t>(slot), first = s * static_cast<uint32_t>(plan.max_features);
  engine::Buffer view;
  view.image = depth.view.view;
  view.image_layout = depth.view.layout;
  shaders::ChoosePush push{};
  push.border = cells.border;
  push.width = cells.width;
  push.height = cells.height;
  push.columns = cells.columns;
  push.rows = cells.rows;
  push.row_pixels = layout.row_pixels();
  push.first_word = s * layout.pixel_words;
  push.first_feature = first;
  push.inverse = depth.inverse;
  push.scale = depth.scale;
  push.offset = depth.offset;
  push.background = depth.background;
  const engine::Buffer &list = memory[ids.features], &references = memory[ids.references];
  recorder.stage("choose");
  recorder.dispatch(kernels.choose, {&memory[ids.pixels0], &view, &list}, push, {cells.columns, cells.rows, 1});
  recorder.dispatch(kernels.chosen, {&references, &list}, shaders::ChosenPush{s, first, 0, 0}, {1, 1, 1});
}

namespace internal {

void Stages::enable(Recorder& recorder, uint32_t pairs) const {
  const shaders::ChosenPush push{0, 0, static_cast<uint32_t>(options.min_features), pairs};
  recorder.dispatch(kernels.enable, {&at(ids.references), &run[run_ids.pairs]}, push,
                    {groups_for(pairs, ICLK_CHOOSE_GROUP), 1, 1});
}

void Stages::keep_features(Recorder& recorder, uint32_t slot, uint32_t pair) const {
  const uint64_t bytes = sizeof(shaders::FeatureInfo) * static_cast<uint64_t>(plan.max_features);
  const VkBufferCopy region{bytes * slot, bytes * pair, bytes};
  recorder.copy(at(ids.features), run[*run_ids.features], std::span(&region, 1));
}

const shaders::FeatureInfo* read_features(const RunBuffers& ids, const engine::Workspace& run) {
  return run[ids.features_read.value_or(*ids.features)].as<const shaders::FeatureInfo>();
}

Features unpack_features(const shaders::FeatureInfo* features, uint32_t count) {
  Features out;
  for (uint32_t i = 0; i < count; ++i) {
    out.uv.emplace_back(features[i].u, features[i].v);
    out.inverse_depth.push_back(features[i].inverse_depth);
  }
  return out;
}

void Awaited::take(const shaders::FeatureInfo* features, const AlignerOptions& options) {
  double sum = 0;
  checks.clear();
  for (uint32_t i = 0; i < chosen; ++i) {
    const float q = features[i].inverse_depth;
    checks.push_back(q > 0 ? FeatureCheck::ok : FeatureCheck::no_depth);
    sum += q;
  }
  const int usable = count_ok(checks);
  enough = usable >= options.min_features;
  mean_inverse_depth = usable > 0 ? sum / usable : 0;
}

}  // namespace internal

}  // namespace iclk
