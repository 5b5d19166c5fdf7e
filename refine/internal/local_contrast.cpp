#include <iclk/refine/internal/local_contrast.h>

#include <algorithm>
#include <cmath>

#include <iclk/align/pyramid.h>

namespace iclk::internal {
namespace {

constexpr double kSigma = 0.016;    // of the width
constexpr float kContrast = 0.16f;  // of the result, standard deviation
constexpr float kLeastDeviation = 4 / 255.0f;
constexpr int kBoxes = 3;  // three boxes are nearly a Gaussian

/// Means over boxes of 2 radius + 1 values, `step` apart; the border values are repeated.
void box(const float* from, float* to, int count, int step, int radius) {
  const auto at = [&](int i) { return from[static_cast<std::ptrdiff_t>(std::clamp(i, 0, count - 1)) * step]; };
  double sum = 0;
  for (int i = -radius; i <= radius; ++i) sum += at(i);
  for (int i = 0; i < count; ++i) {
    to[static_cast<std::ptrdiff_t>(i) * step] = static_cast<float>(sum / (2 * radius + 1));
    sum += at(i + radius + 1) - at(i - radius);
  }
}

void smooth(Map& map, int radius) {
  Map other(map.width, map.height);
  for (int k = 0; k < kBoxes; ++k) {
    for (int v = 0; v < map.height; ++v) box(&map.at(0, v), &other.at(0, v), map.width, 1, radius);
    for (int u = 0; u < map.width; ++u) box(&other.at(u, 0), &map.at(u, 0), map.height, map.width, radius);
  }
}

}  // namespace

FloatImage local_contrast(const ImageView& image, const ImageView& mask) {
  const Map grey = grey_map(image);
  const double sigma = std::max(2.0, kSigma * image.width);
  // The variance of a box of n values is (n^2 - 1) / 12.
  const int radius = std::max(1, static_cast<int>(std::lround(0.5 * (std::sqrt(12 * sigma * sigma / kBoxes + 1) - 1))));
  Map weight(image.width, image.height), known = grey;
  for (int v = 0; v < image.height; ++v)
    for (int u = 0; u < image.width; ++u) {
      const bool counts = std::abs(grey.at(u, v)) < 1e6f && (mask.empty() || mask.row(v)[u] != 0);
      weight.at(u, v) = counts ? 1.0f : 0.0f;
      if (!counts) known.at(u, v) = 0;
    }
  const Map counted = weight;
  smooth(weight, radius);
  const auto mean_of = [&](Map map) {
    smooth(map, radius);
    for (size_t i = 0; i < map.data.size(); ++i) map.data[i] /= std::max(weight.data[i], 1e-3f);
    return map;
  };
  const Map mean = mean_of(known);
  Map square(image.width, image.height);
  for (size_t i = 0; i < square.data.size(); ++i)
    square.data[i] = counted.data[i] * (known.data[i] - mean.data[i]) * (known.data[i] - mean.data[i]);
  const Map variance = mean_of(std::move(square));
  FloatImage out;
  out.pixels.resize(grey.data.size());
  for (size_t i = 0; i < out.pixels.size(); ++i) {
    const float deviation = std::sqrt(std::max(variance.data[i], 0.0f)) + kLeastDeviation;
    out.pixels[i] = std::isfinite(grey.data[i])
                        ? std::clamp(0.5f + kContrast * (grey.data[i] - mean.data[i]) / deviation, 0.0f, 1.0f)
                        : grey.data[i];
  }
  out.view = {out.pixels.data(), image.width, image.height, 0, PixelFormat::r32f};
  return out;
}

}  // namespace iclk::internal
