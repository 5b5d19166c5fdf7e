#pragma once
#include <cstdint>

#include <vulkan/vulkan_core.h>

namespace iclk::engine {

/// A buffer as kernels and recorders take it: no owner. A VkBuffer of the application is wrapped by filling in handle and size.
struct Buffer {
  VkBuffer handle = VK_NULL_HANDLE;
  VkBufferView view = VK_NULL_HANDLE;  ///< of the whole buffer, if it has a texel format
  VkDeviceSize size = 0;               ///< bytes
  void* mapped = nullptr;              ///< host address, coherent; null: not mapped
  VkBuffer twin = VK_NULL_HANDLE;      ///< where `mapped` lies, of a table that is not mapped itself

  /// An image of the application in the place of a buffer, for BindingKind::sampled_image; all else is null.
  VkImageView image = VK_NULL_HANDLE;
  VkImageLayout image_layout = VK_IMAGE_LAYOUT_UNDEFINED;

  template <class T>
  T* as() const {
    return static_cast<T*>(mapped);
  }
};

/// An image of the application, used in the state in which it is handed over and given back in the same.
struct ForeignImage {
  VkImage handle = VK_NULL_HANDLE;  ///< with VK_IMAGE_USAGE_TRANSFER_SRC_BIT, one sample, colour
  VkFormat format = VK_FORMAT_UNDEFINED;
  uint32_t width = 0, height = 0;  ///< of mip level 0
  /// When the commands execute; restored. UNDEFINED has no content and is refused.
  VkImageLayout layout = VK_IMAGE_LAYOUT_UNDEFINED;
  /// The family that owns it, if it is exclusive and not ours: the application has released it to our family in this layout and
  /// acquires it back afterwards. IGNORED: concurrent, or already ours.
  uint32_t queue_family = VK_QUEUE_FAMILY_IGNORED;
};

/// Bytes of vkAllocateMemory a kind.
struct MemoryBytes {
  VkDeviceSize device = 0, upload = 0, readback = 0;
  VkDeviceSize total() const { return device + upload + readback; }
  bool operator==(const MemoryBytes&) const = default;
};

}  // namespace iclk::engine
