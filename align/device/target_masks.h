#pragma once
#include <iclk/align/plan/layout.h>
#include <iclk/engine/compute/kernel.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/engine/compute/recorder.h>

namespace iclk::internal {

/// Writes the masks of host targets into the alpha of their pixels, which have one of Plan::format's formats of four channels:
/// 0 where the mask is 0, opaque elsewhere or without a mask.
void write_alpha(const ImageView& mask, const Plan& plan, uint32_t row_pixels, void* pixels);

/// Hides pixels of targets' maps on a device where alpha is 0 (shaders/align/hide.comp, shaders/align/hide_level.comp).
class TargetMasks {
 public:
  TargetMasks() = default;
  /// For plans with target_masks.
  TargetMasks(std::shared_ptr<const engine::Context> context, const Plan& plan, const Layout& layout, uint32_t group);
  explicit operator bool() const { return static_cast<bool>(hide_); }

  /// In the maps of a layout without level0_in_pixels, all its levels. Images first .. first + count - 1.
  void record(engine::Recorder& recorder, const engine::Buffer& pixels, const engine::Buffer& maps, const Layout& layout,
              uint32_t first, uint32_t count) const;
  /// In one packed map an image, from the first on, a pixel of which is `scale` of the image.
  void record(engine::Recorder& recorder, const engine::Buffer& pixels, const engine::Buffer& maps, uint32_t width,
              uint32_t height, uint32_t scale, uint32_t count) const;

  /// Room for one buffer of each kind.
  void add_to(engine::ArenaSize& size) const;

 private:
  uint32_t group_ = 1, row_pixels_ = 0, pixel_words_ = 0;
  engine::Kernel hide_, hide_level_;
};

}  // namespace iclk::internal
