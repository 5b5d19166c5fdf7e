#include <iclk/align/device/grey_pyramid.h>

#include <iclk/align/device/kernels.h>

#include "halve.comp.spv.h"
#include "pyramid.comp.spv.h"

namespace iclk::internal {

GreyPyramid::GreyPyramid(std::shared_ptr<const engine::Context> context, PixelFormat format, const Layout& layout,
                         uint32_t group)
    : group_(group),
      blocks_y_(layout.blocks_y),
      empty_(layout.levels.size() == 1 && layout.level0_in_pixels),
      levels_(layout.levels) {
  using enum engine::BindingKind;
  const auto offset = [&](size_t level) { return level < levels_.size() ? levels_[level].map_offset : 0; };
  push_.height = levels_[0].height;
  push_.offset_0 = offset(0);
  push_.offset_1 = offset(1);
  push_.offset_2 = offset(2);
  push_.offset_3 = offset(3);
  push_.blocks_x = layout.blocks_x;
  push_.pixel_stride = layout.pixel_words;
  push_.map_stride = layout.map_stride;
  pyramid_ = {context,
              {"pyramid",
               pyramid_comp_spv,
               {storage_read, storage_write},
               sizeof(shaders::PyramidPush),
               {group_, shader_format(format), static_cast<uint32_t>(levels_.size()), !layout.level0_in_pixels}}};
  if (levels_.size() > ICLK_FUSED_LEVELS)
    halve_ = {context, {"pyramid", halve_comp_spv, {storage_read, storage_read_write}, sizeof(shaders::HalvePush), {group_}}};
}

void GreyPyramid::record(engine::Recorder& recorder, const engine::Buffer& levels, const engine::Buffer& pixels,
                         const engine::Buffer& maps, uint32_t first, uint32_t count, const GreyWeights& weights) const {
  recorder.stage("pyramid");
  shaders::PyramidPush push = push_;
  push.first_image = first;
  push.red = weights[0];
  push.green = weights[1];
  push.blue = weights[2];
  if (!empty_)
    recorder.dispatch(pyramid_, {&pixels, &maps}, push, {engine::groups_for(push.blocks_x, group_), blocks_y_, count});
  for (size_t l = ICLK_FUSED_LEVELS; l < levels_.size(); ++l)
    recorder.dispatch(halve_, {&levels, &maps}, shaders::HalvePush{static_cast<uint32_t>(l), push.map_stride, first},
                      {engine::groups_for(levels_[l].width, group_), levels_[l].height, count});
}

void GreyPyramid::add_to(engine::ArenaSize& size, uint32_t sources) const {
  size.add(pyramid_, sources);
  if (halve_) size.add(halve_, sources);
}

}  // namespace iclk::internal
