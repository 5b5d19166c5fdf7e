#pragma once
#include <iclk/align/plan/layout.h>
#include <iclk/align/pyramid.h>
#include <iclk/engine/compute/kernel.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/engine/compute/recorder.h>

namespace iclk::internal {

/// Makes grey pyramids on a device, from raw pixels (shaders/align/pyramid.comp, shaders/align/halve.comp).
class GreyPyramid {
 public:
  GreyPyramid() = default;
  /// Precondition: a layout without a model.
  GreyPyramid(std::shared_ptr<const engine::Context> context, PixelFormat format, const Layout& layout, uint32_t group);

  /// Makes the maps of images first .. first + count - 1 of `pixels`. `levels` contains layout.levels.
  void record(engine::Recorder& recorder, const engine::Buffer& levels, const engine::Buffer& pixels,
              const engine::Buffer& maps, uint32_t first, uint32_t count, const GreyWeights& weights = kLuma) const;

  /// Room for `sources` pairs of buffers (pixels, maps).
  void add_to(engine::ArenaSize& size, uint32_t sources) const;

 private:
  uint32_t group_ = 1, blocks_y_ = 0;
  bool empty_ = true;  // the only level is the pixels themselves
  shaders::PyramidPush push_{};
  std::vector<shaders::LevelInfo> levels_;
  engine::Kernel pyramid_, halve_;
};

}  // namespace iclk::internal
