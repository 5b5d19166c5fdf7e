#pragma once
// The inputs of DeviceAligner::record() and DeviceRefiner::record(): images of the application on its device.
#include <limits>
#include <optional>
#include <variant>

#include <iclk/align/aligner.h>
#include <iclk/engine/resources.h>

namespace iclk {

/// A target or reference in a buffer of the application, with pixels of the plan's format.
struct DeviceBufferImage {
  VkBuffer buffer = VK_NULL_HANDLE;
  VkDeviceSize size = 0;    ///< of the buffer, bytes
  VkDeviceSize offset = 0;  ///< of the first pixel, bytes; a multiple of 4
  uint32_t row_pixels = 0;  ///< from one row to the next; 0: rows are packed
};

/// A target or reference that is sampled, without a copy: any mip, layer or plane, in any format that can be fetched as floats
/// (R16, RG8, RGBA16F, the luma plane of NV12, ...). Before the alignment, the image must be in `layout` and visible to compute
/// shader reads. Use UNORM views: sRGB views return linear values, which the method does not expect.
struct DeviceImageView {
  VkImageView view = VK_NULL_HANDLE;  ///< 2D, of an image with VK_IMAGE_USAGE_SAMPLED_BIT, one sample, colour
  VkImageLayout layout = VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL;
  uint32_t width = 0, height = 0;  ///< of the view's mip level; the size of the plan
  bool grey = false;               ///< true: the first channel is the grey value; false: red, green, blue
};

/// An image on the device: an image view, a VkImage or a VkBuffer. A VkImage must have the plan's format: R8_UNORM,
/// R8G8B8A8_UNORM, B8G8R8A8_UNORM or their SRGB twins, R32_SFLOAT, R32G32B32A32_SFLOAT. Images and buffers are copied on the
/// device when the commands execute. iclk never frees or keeps them.
using DeviceImage = std::variant<engine::ForeignImage, DeviceBufferImage, DeviceImageView>;

/// A depth image of a reference, made by the application: depth along the optical axis for every pixel. The value of a texel d
/// is scale d + offset; it is the depth, or with `inverse` the inverse depth. Values that are not positive and finite mean
/// unknown.
struct DeviceDepth {
  DeviceImageView view;  ///< its first channel; the depth aspect of a depth format is allowed
  bool inverse = false;
  float scale = 1, offset = 0;
  float background = std::numeric_limits<float>::quiet_NaN();  ///< texels of this value have no depth

  /// For the depth buffer of a perspective projection, which maps depth z0 to 0 and depth z1 to 1. Either may be the nearer
  /// one, and the farther one may be infinite. Texels with the value of the farther one are background.
  static DeviceDepth projected(const DeviceImageView& view, float z0, float z1);
};

/// Reference, for images on the device.
struct DeviceReference {
  int slot = 0;
  DeviceImage image;
  Camera camera;
  Features features;  ///< empty if `depth` is set
  /// With a depth image the device chooses the features: one per cell, in up to Plan::max_features cells that cover the image.
  /// It chooses the pixel with depth that has the most texture. It uses depth edges only in cells without other candidates.
  /// Needs Plan::choose_features.
  std::optional<DeviceDepth> depth = {};
};

/// Pair, for images on the device.
struct DevicePair {
  int reference = 0;
  DeviceImage target;
  SE3 T_10;
  std::optional<PosePrior> prior;
  bool search = true;  ///< see Pair::search
  /// See Pair::target_mask: the first channel of an image of the plan's size. It replaces the alpha of the target.
  std::optional<DeviceImageView> target_mask = {};
};

}  // namespace iclk
