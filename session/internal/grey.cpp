#include <iclk/session/internal/grey.h>

#include <algorithm>
#include <cmath>

namespace iclk {
namespace {

/// The positions of red, green and blue in a pixel.
struct Order {
  int red, green, blue;
};

Order order_of(PixelFormat format) {
  switch (format) {
    case PixelFormat::r8:
    case PixelFormat::r16:
    case PixelFormat::r32f: return {0, 0, 0};
    case PixelFormat::bgr8:
    case PixelFormat::bgra8:
    case PixelFormat::bgr16: return {2, 1, 0};
    default: return {0, 1, 2};
  }
}

/// Rounded equally on all machines, with or without FMA instructions.
float luma(const float* p, Order at) { return std::fma(0.114f, p[at.blue], std::fma(0.587f, p[at.green], 0.299f * p[at.red])); }

/// Luma in integers, in units of 2^-15.
template <class T>
T luma(const T* p, Order at) {
  return static_cast<T>((9798u * p[at.red] + 19235u * p[at.green] + 3735u * p[at.blue] + (1u << 14)) >> 15);
}

template <class T>
std::vector<T> grey_values(const ImageView& image) {
  const int step = channels(image.format);
  const Order at = order_of(image.format);
  std::vector<T> out(static_cast<size_t>(image.width) * static_cast<size_t>(image.height));
  T* to = out.data();
  for (int v = 0; v < image.height; ++v, to += image.width) {
    const T* from = reinterpret_cast<const T*>(image.row(v));
    if (step == 1)
      std::copy_n(from, image.width, to);
    else
      for (int u = 0; u < image.width; ++u) to[u] = luma(from + static_cast<ptrdiff_t>(u) * step, at);
  }
  return out;
}

template <class T>
std::vector<uint8_t> stretched(const std::vector<T>& values) {
  const auto [low, high] = std::minmax_element(values.begin(), values.end());
  const double range = static_cast<double>(*high) - static_cast<double>(*low);
  std::vector<uint8_t> out(values.size());
  if (!(range > 0) || !std::isfinite(range)) return out;
  const auto scale = static_cast<float>(255 / range), shift = static_cast<float>(-static_cast<double>(*low) * (255 / range));
  for (size_t i = 0; i < out.size(); ++i) {
    const auto value = static_cast<float>(static_cast<double>(values[i]) * scale + shift);
    out[i] = static_cast<uint8_t>(std::lrint(std::clamp(value, 0.0f, 255.0f)));
  }
  return out;
}

}  // namespace

std::vector<uint8_t> grey_8bit(const ImageView& image) {
  switch (bytes_per_pixel(image.format) / static_cast<size_t>(channels(image.format))) {
    case sizeof(uint8_t): return grey_values<uint8_t>(image);
    case sizeof(uint16_t): return stretched(grey_values<uint16_t>(image));
    default: return stretched(grey_values<float>(image));
  }
}

}  // namespace iclk
