#pragma once
#include <cstdint>

#include <vulkan/vulkan_core.h>

namespace iclk::engine {

/// A buffer for kernels and recorders; it owns nothing. To use a VkBuffer of the application, set `handle` and `size`.
struct Buffer {
  VkBuffer handle = VK_NULL_HANDLE;
  VkBufferView view = VK_NULL_HANDLE;  ///< of the whole buffer, if it has a texel format
  VkDeviceSize size = 0;               ///< bytes
  void* mapped = nullptr;              ///< host address, coherent; null: not mapped
  VkBuffer twin = VK_NULL_HANDLE;      ///< the buffer that `mapped` belongs to, if a table is not mapped itself

  /// An image of the application instead of a buffer, for BindingKind::sampled_image; all other fields are null.
  VkImageView image = VK_NULL_HANDLE;
  VkImageLayout image_layout = VK_IMAGE_LAYOUT_UNDEFINED;

  template <class T>
  T* as() const {
    return static_cast<T*>(mapped);
  }
};

/// An image of the application. It returns in the layout and queue family in which it was passed.
struct ForeignImage {
  VkImage handle = VK_NULL_HANDLE;  ///< with VK_IMAGE_USAGE_TRANSFER_SRC_BIT, one sample, colour
  VkFormat format = VK_FORMAT_UNDEFINED;
  uint32_t width = 0, height = 0;  ///< of mip level 0
  /// The layout when the commands execute; it is restored afterwards. VK_IMAGE_LAYOUT_UNDEFINED is rejected.
  VkImageLayout layout = VK_IMAGE_LAYOUT_UNDEFINED;
  /// The owning queue family of an exclusive image, if it is not the family of iclk. The application must release the image
  /// to iclk's family in this layout before, and acquire it back afterwards. IGNORED: concurrent, or already in iclk's family.
  uint32_t queue_family = VK_QUEUE_FAMILY_IGNORED;
};

/// Bytes allocated by vkAllocateMemory, by kind.
struct MemoryBytes {
  VkDeviceSize device = 0, upload = 0, readback = 0;
  VkDeviceSize total() const { return device + upload + readback; }
  bool operator==(const MemoryBytes&) const = default;
};

}  // namespace iclk::engine
