#include <iclk/align/pyramid.h>

#include <algorithm>
#include <cstring>

namespace iclk {
namespace {

template <class T>
float luma(const T* p, int r, int g, int b, float scale) {
  return (0.299f * static_cast<float>(p[r]) + 0.587f * static_cast<float>(p[g]) + 0.114f * static_cast<float>(p[b])) * scale;
}

template <class T>
void grey_row(const ImageView& image, int v, float scale, float* out) {
  const int n = channels(image.format);
  const bool bgr =
      image.format == PixelFormat::bgr8 || image.format == PixelFormat::bgra8 || image.format == PixelFormat::bgr16;
  std::vector<T> row(static_cast<size_t>(image.width) * n);
  std::memcpy(row.data(), image.row(v), row.size() * sizeof(T));  // the caller's rows need not be aligned to T
  for (int u = 0; u < image.width; ++u) {
    const T* p = row.data() + static_cast<size_t>(u) * n;
    out[u] = n == 1 ? static_cast<float>(p[0]) * scale : luma(p, bgr ? 2 : 0, 1, bgr ? 0 : 2, scale);
  }
}

}  // namespace

double Map::bilinear(double u, double v) const {
  u = std::clamp(u, 0.0, width - 1.0);
  v = std::clamp(v, 0.0, height - 1.0);
  const int u0 = std::min(static_cast<int>(u), width - 2), v0 = std::min(static_cast<int>(v), height - 2);
  const double a = u - u0, b = v - v0;
  const float* p = data.data() + static_cast<size_t>(v0) * width + u0;
  return (1 - b) * ((1 - a) * p[0] + a * p[1]) + b * ((1 - a) * p[width] + a * p[width + 1]);
}

double Map::gradient_u(int u, int v) const {
  return 0.5 * (static_cast<double>(at(std::min(u + 1, width - 1), v)) - at(std::max(u - 1, 0), v));
}

double Map::gradient_v(int u, int v) const {
  return 0.5 * (static_cast<double>(at(u, std::min(v + 1, height - 1))) - at(u, std::max(v - 1, 0)));
}

Map grey_map(const ImageView& image) {
  Map map(image.width, image.height);
  for (int v = 0; v < image.height; ++v) {
    float* out = map.data.data() + static_cast<size_t>(v) * image.width;
    switch (image.format) {
      case PixelFormat::r8:
      case PixelFormat::rgb8:
      case PixelFormat::bgr8:
      case PixelFormat::rgba8:
      case PixelFormat::bgra8: grey_row<uint8_t>(image, v, 1.0f / 255.0f, out); break;
      case PixelFormat::r16:
      case PixelFormat::rgb16:
      case PixelFormat::bgr16: grey_row<uint16_t>(image, v, 1.0f / 65535.0f, out); break;
      case PixelFormat::r32f:
      case PixelFormat::rgb32f:
      case PixelFormat::rgba32f: grey_row<float>(image, v, 1.0f, out); break;
    }
  }
  return map;
}

Map half_size(const Map& map) {
  Map half(map.width / 2, map.height / 2);
  for (int v = 0; v < half.height; ++v)
    for (int u = 0; u < half.width; ++u)
      half.at(u, v) = 0.25f * ((map.at(2 * u, 2 * v) + map.at(2 * u + 1, 2 * v)) +
                               (map.at(2 * u, 2 * v + 1) + map.at(2 * u + 1, 2 * v + 1)));
  return half;
}

Pyramid grey_pyramid(const ImageView& image, int levels) {
  Pyramid pyramid{grey_map(image)};
  while (static_cast<int>(pyramid.size()) < levels) pyramid.push_back(half_size(pyramid.back()));
  return pyramid;
}

}  // namespace iclk
