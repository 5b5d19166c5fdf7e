#include <iclk/align/network/feature_maps.h>

#include "feature_map.comp.spv.h"
#include "feature_sums.comp.spv.h"

namespace iclk::internal {
namespace {

constexpr uint32_t kLanes = 64;

}  // namespace

FeatureMaps::FeatureMaps(std::shared_ptr<const engine::Context> context) {
  using enum engine::BindingKind;
  constexpr uint32_t bytes = sizeof(shaders::FeatureMapPush);
  whole_ = {context, {"encode", feature_map_comp_spv, {texel_read, storage_write, storage_write}, bytes, {kLanes}}};
  for (const uint32_t whole : {0u, 1u})
    sums_[whole] = {context, {"encode", feature_sums_comp_spv, {storage_read, storage_write}, bytes, {kLanes, whole}}};
}

void FeatureMaps::record(engine::Recorder& recorder, const ConvStep& last, const engine::Buffer& made,
                         const engine::Buffer& next, const MapPlace& place, const MapPart& part) const {
  const TensorLayout &in = last.out, &half = last.half;
  shaders::FeatureMapPush push{};
  push.width = in.width;
  push.height = in.height;
  set_place(push, place);
  push.first_image = part.first_image;
  push.inverse_channels = 1.0f / static_cast<float>(in.channels);
  const engine::Groups groups{engine::groups_for((in.width + 1) / 2, kLanes), (in.height + 1) / 2, part.count};
  if (last.reduced) {
    const ChannelSums sums = channel_sums(last);
    push.in_offset = sums.offset + part.at * sums.image();
    push.in_pitch = sums.pitch;
    push.in_plane = sums.plane;
    push.in_image = sums.image();
    push.in_planes = sums.planes;
    recorder.dispatch(sums_[place.whole(in.width)], {&made, part.maps}, push,
                      {engine::groups_for((in.width + 3) / 4, kLanes), groups.y, groups.z});
    return;
  }
  push.in_offset = in.offset() + part.at * in.image();
  push.in_pitch = in.pitch();
  push.in_plane = in.plane();
  push.in_image = in.image();
  push.in_planes = in.planes();
  push.halves = half.width > 0 && half.height > 0;
  push.out_offset = half.offset() + part.at * half.image();
  push.out_pitch = half.pitch();
  push.out_plane = half.plane();
  push.out_image = half.image();
  recorder.dispatch(whole_, {&made, part.maps, &next}, push, groups);
}

void FeatureMaps::add_to(engine::ArenaSize& size, uint32_t sources) const {
  size.add(whole_, 2 * sources);
  for (const engine::Kernel& kernel : sums_) size.add(kernel, 2 * sources);
}

}  // namespace iclk::internal
