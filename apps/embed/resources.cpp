#include "apps/embed/resources.h"

#include <iclk/engine/result.h>

namespace embed {
namespace {

using iclk::engine::check;

constexpr VkImageSubresourceRange kAll{VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};

/// What a command does with an image.
struct Use {
  VkPipelineStageFlags stage;
  VkAccessFlags access;
  VkImageLayout layout;
};

void barrier(VkCommandBuffer commands, VkImage image, const Use& before, const Use& after) {
  VkImageMemoryBarrier b{VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER};
  b.srcAccessMask = before.access;
  b.dstAccessMask = after.access;
  b.oldLayout = before.layout;
  b.newLayout = after.layout;
  b.srcQueueFamilyIndex = b.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
  b.image = image;
  b.subresourceRange = kAll;
  vkCmdPipelineBarrier(commands, before.stage, after.stage, 0, 0, nullptr, 0, nullptr, 1, &b);
}

VkBufferImageCopy whole(const Image& image) {
  return {0, 0, 0, {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1}, {0, 0, 0}, {image.width, image.height, 1}};
}

}  // namespace

Buffer::Buffer(Host& host, VkDeviceSize bytes, VkBufferUsageFlags usage, bool mapped) : Buffer(host) {
  size = bytes;
  VkBufferCreateInfo info{VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO};
  info.size = bytes;
  info.usage = usage;
  check(vkCreateBuffer(host.device, &info, nullptr, &handle), "vkCreateBuffer");
  VkMemoryRequirements needs;
  vkGetBufferMemoryRequirements(host.device, handle, &needs);
  const VkMemoryPropertyFlags kind =
      mapped ? VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT : VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT;
  const VkMemoryAllocateInfo allocate{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO, nullptr, needs.size,
                                      host.memory_type(needs.memoryTypeBits, kind)};
  check(vkAllocateMemory(host.device, &allocate, nullptr, &memory_), "vkAllocateMemory");
  check(vkBindBufferMemory(host.device, handle, memory_, 0), "vkBindBufferMemory");
  if (mapped) check(vkMapMemory(host.device, memory_, 0, VK_WHOLE_SIZE, 0, &data_), "vkMapMemory");
}

Buffer::~Buffer() {
  vkDestroyBuffer(host_.device, handle, nullptr);
  vkFreeMemory(host_.device, memory_, nullptr);
}

Image::Image(Host& host, uint32_t w, uint32_t h, VkFormat format) : Image(host) {
  width = w, height = h;
  VkImageCreateInfo info{VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO};
  info.imageType = VK_IMAGE_TYPE_2D;
  info.format = format;
  info.extent = {w, h, 1};
  info.mipLevels = info.arrayLayers = 1;
  info.samples = VK_SAMPLE_COUNT_1_BIT;
  // iclk needs TRANSFER_SRC of images and SAMPLED of views; the rest is the application's.
  info.usage = VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT |
               VK_IMAGE_USAGE_STORAGE_BIT;
  check(vkCreateImage(host.device, &info, nullptr, &handle), "vkCreateImage");
  VkMemoryRequirements needs;
  vkGetImageMemoryRequirements(host.device, handle, &needs);
  const VkMemoryAllocateInfo allocate{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO, nullptr, needs.size,
                                      host.memory_type(needs.memoryTypeBits, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT)};
  check(vkAllocateMemory(host.device, &allocate, nullptr, &memory_), "vkAllocateMemory");
  check(vkBindImageMemory(host.device, handle, memory_, 0), "vkBindImageMemory");
  VkImageViewCreateInfo seen{VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO};
  seen.image = handle;
  seen.viewType = VK_IMAGE_VIEW_TYPE_2D;
  seen.format = info.format;
  seen.subresourceRange = kAll;
  check(vkCreateImageView(host.device, &seen, nullptr, &view), "vkCreateImageView");
}

Image::~Image() {
  vkDestroyImageView(host_.device, view, nullptr);
  vkDestroyImage(host_.device, handle, nullptr);
  vkFreeMemory(host_.device, memory_, nullptr);
}

void Image::record_fill(VkCommandBuffer commands, VkBuffer pixels) const {
  const Use written{VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_WRITE_BIT, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL};
  barrier(commands, handle,
          {VK_PIPELINE_STAGE_TRANSFER_BIT | VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, 0, VK_IMAGE_LAYOUT_UNDEFINED}, written);
  const VkBufferImageCopy region = whole(*this);
  vkCmdCopyBufferToImage(commands, pixels, handle, written.layout, 1, &region);
  barrier(commands, handle, written,
          {VK_PIPELINE_STAGE_TRANSFER_BIT | VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
           VK_ACCESS_TRANSFER_READ_BIT | VK_ACCESS_SHADER_READ_BIT, VK_IMAGE_LAYOUT_GENERAL});
}

void Image::record_before_drawing(VkCommandBuffer commands) const {
  barrier(commands, handle, {VK_PIPELINE_STAGE_TRANSFER_BIT, 0, VK_IMAGE_LAYOUT_GENERAL},
          {VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_WRITE_BIT, VK_IMAGE_LAYOUT_GENERAL});
}

void Image::record_read(VkCommandBuffer commands, VkBuffer pixels) const {
  barrier(commands, handle, {VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_WRITE_BIT, VK_IMAGE_LAYOUT_GENERAL},
          {VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_READ_BIT, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL});
  const VkBufferImageCopy region = whole(*this);
  vkCmdCopyImageToBuffer(commands, handle, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, pixels, 1, &region);
  const VkMemoryBarrier host{VK_STRUCTURE_TYPE_MEMORY_BARRIER, nullptr, VK_ACCESS_TRANSFER_WRITE_BIT, VK_ACCESS_HOST_READ_BIT};
  vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_PIPELINE_STAGE_HOST_BIT, 0, 1, &host, 0, nullptr, 0,
                       nullptr);
}

}  // namespace embed
