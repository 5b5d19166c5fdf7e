#include <iclk/align/device/upload.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>

#include <iclk/align/pyramid.h>

namespace iclk::internal {
namespace {

bool is_bgr(PixelFormat f) { return f == PixelFormat::bgr8 || f == PixelFormat::bgra8 || f == PixelFormat::bgr16; }

uint8_t to_byte(float x) { return static_cast<uint8_t>(std::lround(255.0f * std::clamp(x, 0.0f, 1.0f))); }

// One row of any format as floats in [0, 1] (floats as they are), RGB or single channel.
template <class T>
void read_row(const ImageView& image, int v, float scale, std::vector<float>& out) {
  const size_t n = static_cast<size_t>(image.width) * channels(image.format);
  std::vector<T> row(n);
  std::memcpy(row.data(), image.row(v), n * sizeof(T));
  out.resize(n);
  for (size_t i = 0; i < n; ++i) out[i] = static_cast<float>(row[i]) * scale;
}

void row_as_float(const ImageView& image, int v, std::vector<float>& out) {
  const size_t size = bytes_per_pixel(image.format) / static_cast<size_t>(channels(image.format));
  if (size == 1)
    read_row<uint8_t>(image, v, 1.0f / 255.0f, out);
  else if (size == 2)
    read_row<uint16_t>(image, v, 1.0f / 65535.0f, out);
  else
    read_row<float>(image, v, 1.0f, out);
}

// 8-bit pixels of N bytes to four, the common case, without a detour over floats: a word at a time, as single bytes are slow to
// write into memory that is not cached, which that of a GPU is not.
template <int N, bool kSwap>
void bytes_to_four(const ImageView& image, int v, uint8_t* out) {
  static_assert(std::endian::native == std::endian::little);
  const uint8_t* p = image.row(v);
  const auto put = [&](uint32_t word) {
    if constexpr (kSwap) word = (word << 24 | (word & 0xff00u) << 8 | (word >> 8 & 0xff00u) | word >> 24) >> 8;  // one bswap
    word |= 0xff000000u;
    std::memcpy(out, &word, 4);
    p += N;
    out += 4;
  };
  if constexpr (N == 1) {
    for (int u = 0; u < image.width; ++u) put(0x010101u * p[0]);
    return;
  }
  for (int u = 0; u + 1 < image.width; ++u) {
    uint32_t word;
    std::memcpy(&word, p, 4);  // the next pixel's first byte with it
    put(word);
  }
  put(static_cast<uint32_t>(p[0] | p[1] << 8 | p[2] << 16));
}

using ToFour = void (*)(const ImageView&, int, uint8_t*);
ToFour to_four(int channels, bool swap) {
  if (channels == 1) return bytes_to_four<1, false>;
  if (channels == 3) return swap ? bytes_to_four<3, true> : bytes_to_four<3, false>;
  return swap ? bytes_to_four<4, true> : bytes_to_four<4, false>;
}

}  // namespace

void convert_pixels(const ImageView& image, PixelFormat format, uint32_t row_pixels, void* out) {
  const size_t pitch = row_pixels * bytes_per_pixel(format);
  auto* bytes = static_cast<uint8_t*>(out);
  const bool eight_bit = bytes_per_pixel(image.format) == static_cast<size_t>(channels(image.format));
  if (image.format == format) {
    for (int v = 0; v < image.height; ++v, bytes += pitch)
      std::memcpy(bytes, image.row(v), static_cast<size_t>(image.width) * bytes_per_pixel(format));
    return;
  }
  if (eight_bit && (format == PixelFormat::rgba8 || format == PixelFormat::bgra8)) {
    const ToFour row = to_four(channels(image.format), is_bgr(image.format) != is_bgr(format));
    for (int v = 0; v < image.height; ++v, bytes += pitch) row(image, v, bytes);
    return;
  }
  if (channels(format) == 1) {
    const Map grey = grey_map(image);
    for (int v = 0; v < image.height; ++v, bytes += pitch) {
      const float* row = &grey.data[static_cast<size_t>(v) * image.width];
      if (format == PixelFormat::r32f)
        std::memcpy(bytes, row, sizeof(float) * image.width);
      else
        std::transform(row, row + image.width, bytes, to_byte);
    }
    return;
  }
  std::vector<float> row;
  const int n = channels(image.format), r = is_bgr(image.format) ? 2 : 0;
  for (int v = 0; v < image.height; ++v, bytes += pitch) {
    row_as_float(image, v, row);
    for (int u = 0; u < image.width; ++u) {
      const float* p = row.data() + static_cast<size_t>(u) * n;
      const std::array<float, 4> rgba = n == 1 ? std::array{p[0], p[0], p[0], 1.0f} : std::array{p[r], p[1], p[2 - r], 1.0f};
      if (format == PixelFormat::rgba32f) {
        std::memcpy(bytes + sizeof(rgba) * u, rgba.data(), sizeof(rgba));
      } else {
        uint8_t* q = bytes + 4 * static_cast<size_t>(u);
        const bool swap = format == PixelFormat::bgra8;
        for (int c = 0; c < 4; ++c) q[swap && c != 3 ? 2 - c : c] = to_byte(rgba[static_cast<size_t>(c)]);
      }
    }
  }
}

}  // namespace iclk::internal
