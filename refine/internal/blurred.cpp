// Images blurred along a line.
#include <algorithm>
#include <cmath>
#include <map>

#include <iclk/refine/internal/blur.h>

namespace iclk::internal {
namespace {

struct Tap {
  int du, dv;
  float weight;
};

/// Points of the line share their weights among the four pixels around them. Halves are mirrored exactly, or the blur would
/// shift the image.
std::vector<Tap> taps_of(const Eigen::Vector2d& line) {
  std::map<std::pair<int, int>, double> weights;
  const int points = 2 * static_cast<int>(std::ceil(line.norm())) + 1;  // of each half
  for (int i = 0; i < points; ++i)
    for (const int side : {-1, 1}) {
      const Eigen::Vector2d at = side * (i + 0.5) / points / 2 * line;
      const int u = static_cast<int>(std::floor(at.x())), v = static_cast<int>(std::floor(at.y()));
      const double a = at.x() - u, b = at.y() - v;
      weights[{u, v}] += (1 - a) * (1 - b);
      weights[{u + 1, v}] += a * (1 - b);
      weights[{u, v + 1}] += (1 - a) * b;
      weights[{u + 1, v + 1}] += a * b;
    }
  std::vector<Tap> taps;
  for (const auto& [at, weight] : weights)
    if (weight > 0) taps.push_back({at.first, at.second, static_cast<float>(weight / (2 * points))});
  return taps;
}

int mirrored(int x, int size) {
  if (x < 0) x = -x;
  if (x >= size) x = 2 * (size - 1) - x;
  return std::clamp(x, 0, size - 1);
}

}  // namespace

FloatImage blurred(const ImageView& image, const Eigen::Vector2d& line) {
  const bool grey = channels(image.format) == 1;
  std::vector<Map> maps = grey ? std::vector<Map>{grey_map(image)} : rgb_maps(image);
  const int w = image.width, h = image.height, n = static_cast<int>(maps.size());
  const std::vector<Tap> taps = taps_of(line);
  FloatImage out;
  out.pixels.resize(static_cast<size_t>(w) * static_cast<size_t>(h) * static_cast<size_t>(n));
  std::vector<float> sum(static_cast<size_t>(w));
  for (int v = 0; v < h; ++v)
    for (int c = 0; c < n; ++c) {
      std::fill(sum.begin(), sum.end(), 0.0f);
      for (const Tap& tap : taps) {
        const float* from = &maps[static_cast<size_t>(c)].at(0, mirrored(v + tap.dv, h));
        const int begin = std::clamp(-tap.du, 0, w), end = std::clamp(w - tap.du, begin, w);
        for (int u = 0; u < begin; ++u) sum[static_cast<size_t>(u)] += tap.weight * from[mirrored(u + tap.du, w)];
        for (int u = begin; u < end; ++u) sum[static_cast<size_t>(u)] += tap.weight * from[u + tap.du];
        for (int u = end; u < w; ++u) sum[static_cast<size_t>(u)] += tap.weight * from[mirrored(u + tap.du, w)];
      }
      for (int u = 0; u < w; ++u)
        out.pixels[(static_cast<size_t>(v) * static_cast<size_t>(w) + static_cast<size_t>(u)) * static_cast<size_t>(n) +
                   static_cast<size_t>(c)] = sum[static_cast<size_t>(u)];
    }
  out.view = {out.pixels.data(), w, h, 0, grey ? PixelFormat::r32f : PixelFormat::rgb32f};
  return out;
}

BlurredMask blurred_mask(const ImageView& mask, const Eigen::Vector2d& line) {
  BlurredMask out;
  if (mask.empty()) return out;
  const std::vector<Tap> taps = taps_of(line);
  out.pixels.assign(static_cast<size_t>(mask.width) * static_cast<size_t>(mask.height), 255);
  for (int v = 0; v < mask.height; ++v)
    for (int u = 0; u < mask.width; ++u)
      for (const Tap& tap : taps)
        if (mask.row(mirrored(v + tap.dv, mask.height))[mirrored(u + tap.du, mask.width)] == 0)
          out.pixels[static_cast<size_t>(v) * static_cast<size_t>(mask.width) + static_cast<size_t>(u)] = 0;
  out.view = {out.pixels.data(), mask.width, mask.height, 0, PixelFormat::r8};
  return out;
}

}  // namespace iclk::internal
