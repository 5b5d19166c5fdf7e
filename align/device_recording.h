#pragma once
// What DeviceAligner::record() and DeviceRefiner::record() take: images of the application on its device.
#include <limits>
#include <optional>
#include <variant>

#include <iclk/align/aligner.h>
#include <iclk/engine/resources.h>

namespace iclk {

/// A target or reference that lies in a buffer of the application: pixels of the plan's format, `row_pixels` from a row to the
/// next.
struct DeviceBufferImage {
  VkBuffer buffer = VK_NULL_HANDLE;
  VkDeviceSize size = 0;    ///< of the buffer, bytes
  VkDeviceSize offset = 0;  ///< of the first pixel, a multiple of 4
  uint32_t row_pixels = 0;  ///< 0: rows are packed
};

/// A target or reference that the application samples: any mip, layer or plane, of any format that can be fetched as floats
/// (R16, RG8, RGBA16F, the luma plane of NV12, ...), read without a copy. Before the alignment the image is in `layout` and
/// visible to reads of compute shaders; an sRGB view gives linear values, which are not what the method expects: make a UNORM
/// one.
struct DeviceImageView {
  VkImageView view = VK_NULL_HANDLE;  ///< 2D, of an image with VK_IMAGE_USAGE_SAMPLED_BIT, one sample, colour
  VkImageLayout layout = VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL;
  uint32_t width = 0, height = 0;  ///< of the view's mip level: the plan's
  bool grey = false;               ///< the first channel is the grey value; else red, green, blue are colours
};

/// An image on the device: a view, or a VkImage (format = the plan's: R8_UNORM, R8G8B8A8_UNORM, B8G8R8A8_UNORM or their SRGB
/// twins, R32_SFLOAT, R32G32B32A32_SFLOAT) or a VkBuffer, which are copied on the device when the commands execute. Never freed
/// or kept by us.
using DeviceImage = std::variant<engine::ForeignImage, DeviceBufferImage, DeviceImageView>;

/// Depth along the optical axis for every pixel of a reference, as the application rendered it: of a texel d, scale d + offset
/// is the depth, or with `inverse` its inverse. What is not positive and finite is no depth.
struct DeviceDepth {
  DeviceImageView view;  ///< its first channel; also the depth aspect of a depth format
  bool inverse = false;
  float scale = 1, offset = 0;
  float background = std::numeric_limits<float>::quiet_NaN();  ///< a texel of this value is no depth either

  /// A depth buffer of a perspective projection in which depths of z0 have the value 0 and those of z1 the value 1, which may
  /// be the nearer one, or infinite. What has the value of the farther one is background.
  static DeviceDepth projected(const DeviceImageView& view, float z0, float z1);
};

struct DeviceReference {
  int slot = 0;
  DeviceImage image;
  Camera camera;
  Features features;  ///< none where there is a depth image
  /// The device chooses features in the image where this has depth, one in each of up to Plan::max_features cells that cover
  /// it: the pixel with the most texture, at depth edges only where the cell has nothing else. Needs Plan::choose_features.
  std::optional<DeviceDepth> depth = {};
};

struct DevicePair {
  int reference = 0;
  DeviceImage target;
  SE3 T_10;
  std::optional<PosePrior> prior;
  bool search = true;  ///< as Pair's
  /// As Pair's, in the first channel of an image of the plan's size; takes the place of the target's alpha.
  std::optional<DeviceImageView> target_mask = {};
};

}  // namespace iclk
