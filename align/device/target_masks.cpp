#include <iclk/align/device/target_masks.h>

#include <cstring>

#include "hide.comp.spv.h"
#include "hide_level.comp.spv.h"

namespace iclk::internal {

using engine::groups_for;

void write_alpha(const ImageView& mask, const Plan& plan, uint32_t row_pixels, void* pixels) {
  const size_t pixel = bytes_per_pixel(plan.format), row = row_pixels * pixel;
  const bool floats = plan.format == PixelFormat::rgba32f;
  for (int v = 0; v < plan.height; ++v) {
    auto* alpha = static_cast<uint8_t*>(pixels) + row * static_cast<size_t>(v) + pixel / 4 * 3;
    const uint8_t* seen = mask.empty() ? nullptr : mask.row(v);
    for (int u = 0; u < plan.width; ++u, alpha += pixel) {
      const bool shown = !seen || seen[u];
      if (floats) {
        const float value = shown ? 1.0f : 0.0f;
        std::memcpy(alpha, &value, sizeof value);
      } else {
        *alpha = shown ? 255 : 0;
      }
    }
  }
}

TargetMasks::TargetMasks(std::shared_ptr<const engine::Context> context, const Plan& plan, const Layout& layout, uint32_t group)
    : group_(group), row_pixels_(layout.row_pixels()), pixel_words_(layout.pixel_words) {
  using enum engine::BindingKind;
  const uint32_t floats = plan.format == PixelFormat::rgba32f;
  constexpr uint32_t bytes = sizeof(shaders::HidePush);
  hide_ = {context, {"hide", hide_comp_spv, {storage_read, storage_write}, bytes, {group_, floats}}};
  hide_level_ = {context, {"hide", hide_level_comp_spv, {storage_read_write}, bytes, {group_}}};
}

void TargetMasks::record(engine::Recorder& recorder, const engine::Buffer& pixels, const engine::Buffer& maps,
                         const Layout& layout, uint32_t first, uint32_t count) const {
  recorder.stage("hide");
  shaders::HidePush push{};
  push.map_stride = layout.map_stride;
  push.scale = 1;
  push.row_pixels = row_pixels_;
  push.pixel_words = pixel_words_;
  push.first_image = first;
  for (size_t l = 0; l < layout.levels.size(); ++l) {
    const shaders::LevelInfo& level = layout.levels[l];
    push.width = level.width;
    push.pitch = level.pitch;
    push.offset = level.map_offset;
    const engine::Groups groups{groups_for(level.width, group_), level.height, count};
    if (l == 0)
      recorder.dispatch(hide_, {&pixels, &maps}, push, groups);
    else
      recorder.dispatch(hide_level_, {&maps}, push, groups);
    push.finer_offset = level.map_offset;
    push.finer_pitch = level.pitch;
  }
}

void TargetMasks::record(engine::Recorder& recorder, const engine::Buffer& pixels, const engine::Buffer& maps, uint32_t width,
                         uint32_t height, uint32_t scale, uint32_t count) const {
  shaders::HidePush push{};
  push.width = push.pitch = width;
  push.map_stride = width * height;
  push.scale = scale;
  push.row_pixels = row_pixels_;
  push.pixel_words = pixel_words_;
  recorder.dispatch(hide_, {&pixels, &maps}, push, {groups_for(width, group_), height, count});
}

void TargetMasks::add_to(engine::ArenaSize& size) const {
  if (!hide_) return;
  size.add(hide_, 2);
  size.add(hide_level_);
}

}  // namespace iclk::internal
