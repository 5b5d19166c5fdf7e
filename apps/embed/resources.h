#pragma once
#include "apps/embed/host.h"

namespace embed {

/// A buffer of the application with memory of its own.
class Buffer {
 public:
  /// `mapped`: in memory that the host writes and reads; else the device's.
  Buffer(Host& host, VkDeviceSize bytes, VkBufferUsageFlags usage, bool mapped = false);
  ~Buffer();
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;

  template <class T>
  T* as() const {
    return static_cast<T*>(data_);
  }

  VkBuffer handle = VK_NULL_HANDLE;
  VkDeviceSize size = 0;

 private:
  explicit Buffer(Host& host) : host_(host) {}

  Host& host_;
  VkDeviceMemory memory_ = VK_NULL_HANDLE;
  void* data_ = nullptr;
};

/// An image of the application, to copy to and from, to sample and to draw into by imageStore.
class Image {
 public:
  Image(Host& host, uint32_t width, uint32_t height, VkFormat format = VK_FORMAT_R8G8B8A8_UNORM);
  ~Image();
  Image(const Image&) = delete;
  Image& operator=(const Image&) = delete;

  /// Takes pixels, rows packed, that a transfer may read; what was in the image is lost. Leaves it in GENERAL for
  /// copies and compute shaders that read it.
  void record_fill(VkCommandBuffer commands, VkBuffer pixels) const;
  /// Compute shaders that follow may draw into it: what copied it before has finished. Stays in GENERAL.
  void record_before_drawing(VkCommandBuffer commands) const;
  /// Copies what was drawn to a buffer that the host reads after the submission.
  void record_read(VkCommandBuffer commands, VkBuffer pixels) const;

  VkImage handle = VK_NULL_HANDLE;
  VkImageView view = VK_NULL_HANDLE;
  uint32_t width = 0, height = 0;

 private:
  explicit Image(Host& host) : host_(host) {}

  Host& host_;
  VkDeviceMemory memory_ = VK_NULL_HANDLE;
};

}  // namespace embed
