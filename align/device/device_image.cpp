#include <iclk/align/device/device_image.h>

#include <iclk/align/device/kernels.h>
#include <iclk/engine/error.h>

#include "import.comp.spv.h"
#include "import_mask.comp.spv.h"

namespace iclk::internal {

using engine::groups_for;

namespace {

bool same_pixels(VkFormat format, PixelFormat plan) {
  switch (plan) {
    case PixelFormat::r8: return format == VK_FORMAT_R8_UNORM;
    case PixelFormat::rgba8: return format == VK_FORMAT_R8G8B8A8_UNORM || format == VK_FORMAT_R8G8B8A8_SRGB;
    case PixelFormat::bgra8: return format == VK_FORMAT_B8G8R8A8_UNORM || format == VK_FORMAT_B8G8R8A8_SRGB;
    case PixelFormat::r32f: return format == VK_FORMAT_R32_SFLOAT;
    case PixelFormat::rgba32f: return format == VK_FORMAT_R32G32B32A32_SFLOAT;
    default: return false;
  }
}

engine::Buffer wrapped(const DeviceImageView& view) {
  engine::Buffer buffer;
  buffer.image = view.view;
  buffer.image_layout = view.layout;
  return buffer;
}

}  // namespace

void check_view(const DeviceImageView& view, const Plan& plan, const std::string& what) {
  const auto refuse = [&](const std::string& why) { throw Error(ErrorCode::invalid_argument, what + ": " + why); };
  if (view.view == VK_NULL_HANDLE) refuse("the VkImageView is null");
  if (view.layout == VK_IMAGE_LAYOUT_UNDEFINED || view.layout == VK_IMAGE_LAYOUT_PREINITIALIZED)
    refuse("the image of the VkImageView is in VK_IMAGE_LAYOUT_UNDEFINED, so it has no content; state its layout");
  if (view.width != static_cast<uint32_t>(plan.width) || view.height != static_cast<uint32_t>(plan.height))
    refuse("the VkImageView is " + std::to_string(view.width) + "x" + std::to_string(view.height) +
           ", but the plan was made for " + std::to_string(plan.width) + "x" + std::to_string(plan.height));
}

void check_image(const DeviceImage& image, const Plan& plan, const std::string& what) {
  const auto refuse = [&](const std::string& why) { throw Error(ErrorCode::invalid_argument, what + ": " + why); };
  const std::string size = std::to_string(plan.width) + "x" + std::to_string(plan.height);
  if (const auto* foreign = std::get_if<engine::ForeignImage>(&image)) {
    if (foreign->handle == VK_NULL_HANDLE) refuse("the VkImage is null");
    if (foreign->layout == VK_IMAGE_LAYOUT_UNDEFINED)
      refuse("the VkImage is in VK_IMAGE_LAYOUT_UNDEFINED, so it has no content; state its layout");
    if (foreign->width != static_cast<uint32_t>(plan.width) || foreign->height != static_cast<uint32_t>(plan.height))
      refuse("the VkImage is " + std::to_string(foreign->width) + "x" + std::to_string(foreign->height) +
             ", but the plan was made for " + size);
    if (!same_pixels(foreign->format, plan.format))
      refuse("VkFormat " + std::to_string(foreign->format) + " is not the plan's pixel format");
  } else if (const auto* view = std::get_if<DeviceImageView>(&image)) {
    check_view(*view, plan, what);
  } else {
    const auto& buffer = std::get<DeviceBufferImage>(image);
    const uint32_t row = buffer.row_pixels ? buffer.row_pixels : static_cast<uint32_t>(plan.width);
    if (buffer.buffer == VK_NULL_HANDLE) refuse("the VkBuffer is null");
    if (row < static_cast<uint32_t>(plan.width))
      refuse("rows of " + std::to_string(row) + " pixels are shorter than those of the image");
    const uint64_t need =
        buffer.offset + bytes_per_pixel(plan.format) * (static_cast<uint64_t>(row) * static_cast<uint64_t>(plan.height - 1) +
                                                        static_cast<uint64_t>(plan.width));
    if (buffer.offset % 4 || buffer.offset > buffer.size || need > buffer.size)  // a huge offset overflows in `need`
      refuse("the VkBuffer has " + std::to_string(buffer.size) + " bytes, but the image at offset " +
             std::to_string(buffer.offset) + " (a multiple of 4) needs " + std::to_string(need));
  }
}

DeviceImages::DeviceImages(std::shared_ptr<const engine::Context> context, const Plan& plan, const Layout& layout)
    : plan_(plan), row_pixels_(layout.row_pixels()) {
  using enum engine::BindingKind;
  constexpr uint32_t bytes = sizeof(shaders::ImportPush);
  import_ = {context, {"import", import_comp_spv, {sampled_image, storage_write}, bytes, {0, shader_format(plan.format)}}};
  if (!plan.target_masks) return;
  const uint32_t floats = plan.format == PixelFormat::rgba32f;
  mask_ = {context, {"import", import_mask_comp_spv, {sampled_image, storage_read_write}, bytes, {0, floats}}};
}

void DeviceImages::copy(engine::Recorder& recorder, const DeviceImage& image, const engine::Buffer& pixels,
                        VkDeviceSize offset) const {
  if (const auto* view = std::get_if<DeviceImageView>(&image)) {
    const engine::Buffer source = wrapped(*view);
    const shaders::ImportPush push{view->width, row_pixels_, static_cast<uint32_t>(offset / 4), view->grey};
    const uint32_t words = plan_.format == PixelFormat::r8 ? row_pixels_ / 4 : row_pixels_;
    return recorder.dispatch(import_, {&source, &pixels}, push, {groups_for(words, 64), view->height, 1});
  }
  if (const auto* foreign = std::get_if<engine::ForeignImage>(&image))
    return recorder.copy_image_to_buffer(*foreign, pixels, offset, row_pixels_);
  const auto& source = std::get<DeviceBufferImage>(image);
  const uint64_t pixel = bytes_per_pixel(plan_.format);
  const uint64_t row = pixel * (source.row_pixels ? source.row_pixels : static_cast<uint32_t>(plan_.width));
  std::vector<VkBufferCopy> regions;
  for (uint64_t v = 0; v < static_cast<uint64_t>(plan_.height); ++v)
    regions.push_back({source.offset + row * v, offset + pixel * row_pixels_ * v, pixel * static_cast<uint64_t>(plan_.width)});
  engine::Buffer buffer;
  buffer.handle = source.buffer;
  buffer.size = source.size;
  recorder.copy(buffer, pixels, regions);
}

void DeviceImages::copy_mask(engine::Recorder& recorder, const DeviceImageView& mask, const engine::Buffer& pixels,
                             VkDeviceSize offset) const {
  const engine::Buffer source = wrapped(mask);
  const shaders::ImportPush push{mask.width, row_pixels_, static_cast<uint32_t>(offset / 4), 0};
  recorder.dispatch(mask_, {&source, &pixels}, push, {groups_for(mask.width, 64), mask.height, 1});
}

void DeviceImages::add_to(engine::ArenaSize& size, uint32_t references, uint32_t pairs) const {
  size.add(import_, references + pairs);
  if (mask_) size.add(mask_, pairs);
}

}  // namespace iclk::internal
