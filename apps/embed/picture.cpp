#include "apps/embed/picture.h"

#include <png.h>

#include <cstring>
#include <vector>

#include <iclk/engine/error.h>

namespace embed {

void write_picture(Host& host, const Image& left, const Image& right, const std::string& path) {
  const size_t width = left.width, height = left.height, row = 4 * width;
  const Buffer pixels0(host, row * height, VK_BUFFER_USAGE_TRANSFER_DST_BIT, true),
      pixels1(host, row * height, VK_BUFFER_USAGE_TRANSFER_DST_BIT, true);
  VkCommandBuffer commands = host.begin();
  left.record_read(commands, pixels0.handle);
  right.record_read(commands, pixels1.handle);
  host.submit_and_wait();

  std::vector<uint8_t> both(2 * row * height);
  for (size_t y = 0; y < height; ++y) {
    std::memcpy(&both[2 * row * y], pixels0.as<uint8_t>() + row * y, row);
    std::memcpy(&both[2 * row * y + row], pixels1.as<uint8_t>() + row * y, row);
  }
  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  png.width = static_cast<png_uint_32>(2 * width);
  png.height = static_cast<png_uint_32>(height);
  png.format = PNG_FORMAT_RGBA;
  if (!png_image_write_to_file(&png, path.c_str(), 0, both.data(), 0, nullptr))
    throw iclk::Error(iclk::ErrorCode::io, "cannot write " + path + ": " + png.message);
}

}  // namespace embed
