#pragma once
#include <iclk/align/device_recording.h>
#include <iclk/align/plan/layout.h>
#include <iclk/engine/compute/recorder.h>

namespace iclk::internal {

/// Throw Error(invalid_argument) that begins with `what` for an image that does not fit the plan.
void check_image(const DeviceImage& image, const Plan& plan, const std::string& what);
void check_view(const DeviceImageView& view, const Plan& plan, const std::string& what);

/// Copies images of the application into the raw pixels of an aligner.
class DeviceImages {
 public:
  DeviceImages() = default;
  DeviceImages(std::shared_ptr<const engine::Context> context, const Plan& plan, const Layout& layout);
  explicit operator bool() const { return static_cast<bool>(import_); }

  /// Copies an image to byte `offset` of `pixels`, in the row layout of the aligner's kernels.
  void copy(engine::Recorder& recorder, const DeviceImage& image, const engine::Buffer& pixels, VkDeviceSize offset) const;
  /// Copies a mask into the alpha of existing pixels. Precondition: Plan::target_masks.
  void copy_mask(engine::Recorder& recorder, const DeviceImageView& mask, const engine::Buffer& pixels,
                 VkDeviceSize offset) const;
  void add_to(engine::ArenaSize& size, uint32_t references, uint32_t pairs) const;

 private:
  Plan plan_;
  uint32_t row_pixels_ = 0;
  engine::Kernel import_, mask_;
};

}  // namespace iclk::internal
