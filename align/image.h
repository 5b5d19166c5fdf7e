#pragma once
#include <cstddef>
#include <cstdint>

namespace iclk {

/// The channel order and type of interleaved pixels. Integers are scaled to [0, 1]; floats are used unchanged.
enum class PixelFormat : uint32_t { r8, rgb8, bgr8, rgba8, bgra8, r16, rgb16, bgr16, r32f, rgb32f, rgba32f };

constexpr int channels(PixelFormat f) {
  switch (f) {
    case PixelFormat::r8:
    case PixelFormat::r16:
    case PixelFormat::r32f: return 1;
    case PixelFormat::rgba8:
    case PixelFormat::bgra8:
    case PixelFormat::rgba32f: return 4;
    default: return 3;
  }
}

constexpr size_t bytes_per_pixel(PixelFormat f) {
  switch (f) {
    case PixelFormat::r8: return 1;
    case PixelFormat::r16: return 2;
    case PixelFormat::rgb8:
    case PixelFormat::bgr8: return 3;
    case PixelFormat::rgba8:
    case PixelFormat::bgra8:
    case PixelFormat::r32f: return 4;
    case PixelFormat::rgb16:
    case PixelFormat::bgr16: return 6;
    case PixelFormat::rgb32f: return 12;
    case PixelFormat::rgba32f: return 16;
  }
  return 0;
}

/// A view of pixels of the caller. They are read during the call only. Row-major, top row first.
struct ImageView {
  const void* data = nullptr;
  int width = 0, height = 0;
  size_t row_stride = 0;  ///< bytes from one row to the next; 0: rows are packed
  PixelFormat format = PixelFormat::r8;

  size_t stride() const { return row_stride ? row_stride : static_cast<size_t>(width) * bytes_per_pixel(format); }
  const uint8_t* row(int v) const { return static_cast<const uint8_t*>(data) + stride() * static_cast<size_t>(v); }
  bool empty() const { return data == nullptr || width <= 0 || height <= 0; }
};

}  // namespace iclk
