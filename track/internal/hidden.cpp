#include <iclk/track/internal/hidden.h>

#include <algorithm>
#include <cstring>
#include <type_traits>

namespace iclk::internal {
namespace {

/// An image at half the size: the mean of the seen pixels, where there are any.
void halve(const Map& image, const Map& seen, Map& half, Map& half_seen) {
  for (int v = 0; v < half.height; ++v)
    for (int u = 0; u < half.width; ++u) {
      float sum = 0, count = 0;
      for (int y = 2 * v; y < std::min(2 * v + 2, image.height); ++y)
        for (int x = 2 * u; x < std::min(2 * u + 2, image.width); ++x) {
          sum += seen.at(x, y) * image.at(x, y);
          count += seen.at(x, y);
        }
      half.at(u, v) = count > 0 ? sum / count : 0;
      half_seen.at(u, v) = count > 0 ? 1.0f : 0.0f;
    }
}

void fill_with_mean(Map& image, const Map& seen) {
  float sum = 0, count = 0;
  for (size_t i = 0; i < image.data.size(); ++i) sum += seen.data[i] * image.data[i], count += seen.data[i];
  for (size_t i = 0; i < image.data.size(); ++i)
    if (seen.data[i] == 0) image.data[i] = sum / std::max(count, 1.0f);
}

/// Hidden pixels take the values of the image at half the size, whose hidden pixels are filled before.
void fill(Map& image, const Map& seen) {
  if (image.width < 4 || image.height < 4) return fill_with_mean(image, seen);
  if (std::find(seen.data.begin(), seen.data.end(), 0.0f) == seen.data.end()) return;
  Map half((image.width + 1) / 2, (image.height + 1) / 2), half_seen(half.width, half.height);
  halve(image, seen, half, half_seen);
  fill(half, half_seen);
  for (int v = 0; v < image.height; ++v)
    for (int u = 0; u < image.width; ++u)
      if (seen.at(u, v) == 0) image.at(u, v) = static_cast<float>(half.bilinear(0.5 * u - 0.25, 0.5 * v - 0.25));
}

template <class T>
void fill_channel(std::vector<uint8_t>& pixels, int channel, int channels, const Map& seen) {
  const auto at = [&](size_t i) {
    return &pixels[sizeof(T) * (i * static_cast<size_t>(channels) + static_cast<size_t>(channel))];
  };
  Map image(seen.width, seen.height);
  T value;
  for (size_t i = 0; i < image.data.size(); ++i) {
    std::memcpy(&value, at(i), sizeof value);
    image.data[i] = static_cast<float>(value);
  }
  fill(image, seen);
  for (size_t i = 0; i < image.data.size(); ++i) {
    if (seen.data[i] > 0) continue;
    value = static_cast<T>(std::is_floating_point_v<T> ? image.data[i] : image.data[i] + 0.5f);
    std::memcpy(at(i), &value, sizeof value);
  }
}

}  // namespace

void fill_hidden(FramePixels& pixels, const Camera& camera) {
  if (std::find(pixels.mask.begin(), pixels.mask.end(), 0) == pixels.mask.end()) return;
  Map seen(camera.width, camera.height);
  std::transform(pixels.mask.begin(), pixels.mask.end(), seen.data.begin(), [](uint8_t m) { return m ? 1.0f : 0.0f; });
  const int n = channels(pixels.format);
  const size_t size = bytes_per_pixel(pixels.format) / static_cast<size_t>(n);
  for (int channel = 0; channel < n; ++channel) {
    if (size == 1)
      fill_channel<uint8_t>(pixels.image, channel, n, seen);
    else if (size == 2)
      fill_channel<uint16_t>(pixels.image, channel, n, seen);
    else
      fill_channel<float>(pixels.image, channel, n, seen);
  }
}

}  // namespace iclk::internal
