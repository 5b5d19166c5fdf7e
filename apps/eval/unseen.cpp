#include "apps/eval/unseen.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <opencv2/imgproc.hpp>

#include "apps/eval/appearance.h"

namespace iclk {
namespace {

double uniform(uint64_t seed, uint64_t n) { return static_cast<double>(counter_word(seed, n) >> 11) * 0x1p-53; }

double diagonal(const cv::Mat& image) { return std::hypot(std::max(image.cols - 1, 1), std::max(image.rows - 1, 1)); }

/// Smooth random values in [0, 1]: uniform at the corners of a lattice.
double lattice(uint64_t seed, double x, double y) {
  const double u = std::floor(x), v = std::floor(y), a = smooth_step(x - u), b = smooth_step(y - v);
  const auto at = [&](double i, double j) {
    return uniform(seed, static_cast<uint64_t>(u + i) * 4096 + static_cast<uint64_t>(v + j));
  };
  return (1 - b) * ((1 - a) * at(0, 0) + a * at(1, 0)) + b * ((1 - a) * at(0, 1) + a * at(1, 1));
}

cv::Mat blurred(const cv::Mat& image, double sigma) {
  cv::Mat out;
  cv::GaussianBlur(image, out, {}, std::max(sigma, 0.3), 0, cv::BORDER_REFLECT_101);
  return out;
}

cv::Mat clipped(cv::Mat image) {
  cv::max(image, 0, image);
  cv::min(image, 1, image);
  return image;
}

/// Calls f(u, v, first channel of the pixel) for every pixel.
template <typename F>
cv::Mat each_pixel(const cv::Mat& image, F f) {
  cv::Mat out = image.clone();
  for (int v = 0; v < out.rows; ++v)
    for (int u = 0; u < out.cols; ++u) f(u, v, out.ptr<float>(v) + u * out.channels());
  return clipped(out);
}

}  // namespace

cv::Mat changed(const Clouds& c, const cv::Mat& image) {
  const double unit = c.cells / diagonal(image);
  return each_pixel(image, [&](int u, int v, float* x) {
    const double cover = (2 * lattice(c.seed, u * unit, v * unit) + lattice(c.seed + 1, 2.7 * u * unit, 2.7 * v * unit)) / 3;
    const auto light = static_cast<float>(1 - c.darkness * smooth_step((cover - 0.35) / 0.3));
    for (int k = 0; k < image.channels(); ++k) x[k] *= light;
  });
}

cv::Mat changed(const Droplets& c, const cv::Mat& image) {
  cv::Mat out = image.clone();
  const double d = diagonal(image);
  for (int i = 0; i < c.count; ++i) {
    const auto number = [&](int k) { return uniform(c.seed, static_cast<uint64_t>(4 * i + k)); };
    const double x = number(0) * (image.cols - 1), y = number(1) * (image.rows - 1), radius = d * (0.01 + 0.04 * number(2));
    const cv::Mat soft = blurred(out, 0.5 * radius);
    out = each_pixel(out, [&](int u, int v, float* pixel) {
      const double m = c.amount * smooth_step((1 - std::hypot(u - x, v - y) / radius) / 0.3);
      if (m <= 0) return;
      for (int k = 0; k < image.channels(); ++k)
        pixel[k] = static_cast<float>((1 - m) * pixel[k] + m * (0.8 * soft.ptr<float>(v)[u * image.channels() + k] + 0.15));
    });
  }
  return out;
}

cv::Mat changed(const ChannelMix& c, const cv::Mat& image) {
  if (image.channels() == 1) return image;
  std::array<std::array<double, 3>, 3> M{};
  for (int i = 0; i < 3; ++i) {
    double sum = 0;
    for (int j = 0; j < 3; ++j) sum += M[i][j] = 3 * uniform(c.seed, static_cast<uint64_t>(3 * i + j)) - 1;
    for (double& m : M[i]) m += (1 - sum) / 3;
  }
  return each_pixel(image, [&](int, int, float* x) {
    const std::array<float, 3> given{x[0], x[1], x[2]};
    for (size_t i = 0; i < 3; ++i)
      x[i] = static_cast<float>((1 - c.amount) * given[i] +
                                c.amount * (M[i][0] * given[0] + M[i][1] * given[1] + M[i][2] * given[2]));
  });
}

cv::Mat changed(const Sharpen& c, const cv::Mat& image) {
  return clipped(image + c.amount * (image - blurred(image, c.radius * diagonal(image))));
}

using Json = nlohmann::ordered_json;
Json parameters(const Clouds& c) {
  return {{"change", "clouds"}, {"darkness", c.darkness}, {"cells", c.cells}, {"seed", c.seed}};
}
Json parameters(const Droplets& c) {
  return {{"change", "droplets"}, {"amount", c.amount}, {"count", c.count}, {"seed", c.seed}};
}
Json parameters(const ChannelMix& c) { return {{"change", "channel_mix"}, {"amount", c.amount}, {"seed", c.seed}}; }
Json parameters(const Sharpen& c) { return {{"change", "sharpen"}, {"amount", c.amount}, {"radius", c.radius}}; }

}  // namespace iclk
