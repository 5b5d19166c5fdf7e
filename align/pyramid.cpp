#include <iclk/align/pyramid.h>

#include <algorithm>
#include <cstring>
#include <utility>

namespace iclk {
namespace {

template <class T>
float luma(const T* p, int r, int g, int b, float scale) {
  return (kLuma[0] * static_cast<float>(p[r]) + kLuma[1] * static_cast<float>(p[g]) + kLuma[2] * static_cast<float>(p[b])) *
         scale;
}

bool is_bgr(PixelFormat f) { return f == PixelFormat::bgr8 || f == PixelFormat::bgra8 || f == PixelFormat::bgr16; }

template <class T>
std::vector<T> copy_of_row(const ImageView& image, int v) {
  std::vector<T> row(static_cast<size_t>(image.width) * channels(image.format));
  std::memcpy(row.data(), image.row(v), row.size() * sizeof(T));  // the caller's rows need not be aligned to T
  return row;
}

template <class T>
void grey_row(const ImageView& image, int v, float scale, float* out) {
  const int n = channels(image.format);
  const bool bgr = is_bgr(image.format);
  const std::vector<T> row = copy_of_row<T>(image, v);
  for (int u = 0; u < image.width; ++u) {
    const T* p = row.data() + static_cast<size_t>(u) * n;
    out[u] = n == 1 ? static_cast<float>(p[0]) * scale : luma(p, bgr ? 2 : 0, 1, bgr ? 0 : 2, scale);
  }
}

/// One channel of a row: 0 R, 1 G, 2 B.
template <class T>
void channel_row(const ImageView& image, int v, int channel, float scale, float* out) {
  const int n = channels(image.format);
  const int offset = n == 1 ? 0 : is_bgr(image.format) ? 2 - channel : channel;
  const std::vector<T> row = copy_of_row<T>(image, v);
  for (int u = 0; u < image.width; ++u) out[u] = static_cast<float>(row[static_cast<size_t>(u) * n + offset]) * scale;
}

/// Calls visit(T(), scale) with the type of the format's components and the factor that maps them to [0, 1].
template <class F>
void with_component(PixelFormat format, F&& visit) {
  switch (format) {
    case PixelFormat::r8:
    case PixelFormat::rgb8:
    case PixelFormat::bgr8:
    case PixelFormat::rgba8:
    case PixelFormat::bgra8: visit(uint8_t(), 1.0f / 255.0f); break;
    case PixelFormat::r16:
    case PixelFormat::rgb16:
    case PixelFormat::bgr16: visit(uint16_t(), 1.0f / 65535.0f); break;
    case PixelFormat::r32f:
    case PixelFormat::rgb32f:
    case PixelFormat::rgba32f: visit(float(), 1.0f); break;
  }
}

Pyramid pyramid_of(Map finest, int levels) {
  Pyramid pyramid{std::move(finest)};
  while (static_cast<int>(pyramid.size()) < levels) pyramid.push_back(half_size(pyramid.back()));
  return pyramid;
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

bool Map::hidden(double u, double v) const {
  const int u0 = std::min(static_cast<int>(std::clamp(u, 0.0, width - 1.0)), width - 2);
  const int v0 = std::min(static_cast<int>(std::clamp(v, 0.0, height - 1.0)), height - 2);
  const float* p = data.data() + static_cast<size_t>(v0) * width + u0;
  return p[0] > kHiddenFrom || p[1] > kHiddenFrom || p[width] > kHiddenFrom || p[width + 1] > kHiddenFrom;
}

double Map::gradient_u(int u, int v) const {
  return 0.5 * (static_cast<double>(at(std::min(u + 1, width - 1), v)) - at(std::max(u - 1, 0), v));
}

double Map::gradient_v(int u, int v) const {
  return 0.5 * (static_cast<double>(at(u, std::min(v + 1, height - 1))) - at(u, std::max(v - 1, 0)));
}

Map grey_map(const ImageView& image) {
  Map map(image.width, image.height);
  with_component(image.format, [&](auto component, float scale) {
    for (int v = 0; v < image.height; ++v) grey_row<decltype(component)>(image, v, scale, &map.at(0, v));
  });
  return map;
}

std::vector<Map> rgb_maps(const ImageView& image) {
  std::vector<Map> maps(3, Map(image.width, image.height));
  with_component(image.format, [&](auto component, float scale) {
    for (int channel = 0; channel < 3; ++channel)
      for (int v = 0; v < image.height; ++v)
        channel_row<decltype(component)>(image, v, channel, scale, &maps[static_cast<size_t>(channel)].at(0, v));
  });
  return maps;
}

Map half_size(const Map& map) {
  Map half(map.width / 2, map.height / 2);
  for (int v = 0; v < half.height; ++v)
    for (int u = 0; u < half.width; ++u)
      half.at(u, v) = 0.25f * ((map.at(2 * u, 2 * v) + map.at(2 * u + 1, 2 * v)) +
                               (map.at(2 * u, 2 * v + 1) + map.at(2 * u + 1, 2 * v + 1)));
  return half;
}

Pyramid grey_pyramid(const ImageView& image, int levels) { return pyramid_of(grey_map(image), levels); }

Pyramid grey_pyramid(std::span<const Map> rgb, const GreyWeights& weights, int levels) {
  Map grey(rgb[0].width, rgb[0].height);
  for (size_t i = 0; i < grey.data.size(); ++i)
    grey.data[i] = weights[0] * rgb[0].data[i] + weights[1] * rgb[1].data[i] + weights[2] * rgb[2].data[i];
  return pyramid_of(std::move(grey), levels);
}

void hide(Pyramid& pyramid, const ImageView& mask) {
  if (mask.empty() || pyramid.empty()) return;
  for (int v = 0; v < mask.height; ++v)
    for (int u = 0; u < mask.width; ++u)
      if (mask.row(v)[u] == 0) pyramid[0].at(u, v) = kHidden;
  for (size_t l = 1; l < pyramid.size(); ++l) {
    Map& map = pyramid[l];
    const Map& finer = pyramid[l - 1];
    for (int v = 0; v < map.height; ++v)
      for (int u = 0; u < map.width; ++u)
        if (finer.hidden(2 * u, 2 * v)) map.at(u, v) = kHidden;
  }
}

Map visible_map(const ImageView& image, const ImageView& mask) {
  Pyramid pyramid = {grey_map(image)};
  hide(pyramid, mask);
  return std::move(pyramid[0]);
}

void hide(Pyramid& pyramid, const Pyramid& like) {
  for (size_t l = 0; l < pyramid.size(); ++l)
    for (size_t k = 0; k < pyramid[l].data.size(); ++k)
      if (like[l].data[k] > kHiddenFrom) pyramid[l].data[k] = kHidden;
}

}  // namespace iclk
