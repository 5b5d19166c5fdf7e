#pragma once
#include <iclk/align/plan/layout.h>
#include <iclk/engine/compute/kernel.h>
#include <iclk/engine/compute/memory.h>
#include <iclk/engine/compute/recorder.h>

namespace iclk::internal {

/// Writes the mask of a host target into the alpha of its pixels: 0 where the mask is 0, opaque elsewhere or without a mask.
/// Precondition: Plan::format has four channels.
void write_alpha(const ImageView& mask, const Plan& plan, uint32_t row_pixels, void* pixels);

/// Hides pixels with alpha 0 in the maps of targets on a device (shaders/align/hide.comp, shaders/align/hide_level.comp).
class TargetMasks {
 public:
  TargetMasks() = default;
  /// For plans with target_masks.
  TargetMasks(std::shared_ptr<const engine::Context> context, const Plan& plan, const Layout& layout, uint32_t group);
  explicit operator bool() const { return static_cast<bool>(hide_); }

  /// For all levels of the maps of images first .. first + count - 1. Precondition: not layout.level0_in_pixels.
  void record(engine::Recorder& recorder, const engine::Buffer& pixels, const engine::Buffer& maps, const Layout& layout,
              uint32_t first, uint32_t count) const;
  /// For one packed map per image, from the first image on; its pixels are `scale` pixels of the image wide.
  void record(engine::Recorder& recorder, const engine::Buffer& pixels, const engine::Buffer& maps, uint32_t width,
              uint32_t height, uint32_t scale, uint32_t count) const;

  /// Adds the descriptors for one buffer of each kind.
  void add_to(engine::ArenaSize& size) const;

 private:
  uint32_t group_ = 1, row_pixels_ = 0, pixel_words_ = 0;
  engine::Kernel hide_, hide_level_;
};

}  // namespace iclk::internal
