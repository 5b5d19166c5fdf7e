#include "apps/eval/appearance.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include <iclk/engine/error.h>

namespace iclk {
namespace {

float clamped(float x) { return std::clamp(x, 0.0f, 1.0f); }

template <typename F>
cv::Mat each_value(const cv::Mat& image, F f) {
  cv::Mat out(image.size(), image.type());
  const int row = image.cols * image.channels();
  for (int v = 0; v < image.rows; ++v)
    for (int i = 0; i < row; ++i) out.ptr<float>(v)[i] = clamped(f(image.ptr<float>(v)[i]));
  return out;
}

/// f(value, field at the pixel); `field` takes pixels.
template <typename Field, typename F>
cv::Mat each_place(const cv::Mat& image, Field field, F f) {
  cv::Mat out(image.size(), image.type());
  const int channels = image.channels();
  for (int v = 0; v < image.rows; ++v)
    for (int u = 0; u < image.cols; ++u) {
      const auto g = static_cast<float>(field(u, v));
      for (int i = u * channels; i < (u + 1) * channels; ++i) out.ptr<float>(v)[i] = clamped(f(image.ptr<float>(v)[i], g));
    }
  return out;
}

template <typename F>
cv::Mat each_colour(const cv::Mat& image, F f) {
  cv::Mat out(image.size(), image.type());
  for (int v = 0; v < image.rows; ++v)
    for (int u = 0; u < image.cols; ++u) {
      cv::Vec3f x = f(image.at<cv::Vec3f>(v, u));
      for (float& value : x.val) value = clamped(value);
      out.at<cv::Vec3f>(v, u) = x;
    }
  return out;
}

float grey(const cv::Vec3f& bgr) { return 0.2989f * bgr[2] + 0.587f * bgr[1] + 0.114f * bgr[0]; }

/// (1 - ratio) has the precision of double in torchvision, the products that of the image.
struct Blend {
  float ratio, rest;
  explicit Blend(double r) : ratio(static_cast<float>(r)), rest(static_cast<float>(1 - r)) {}
  float operator()(float x, float other) const { return ratio * x + rest * other; }
};

cv::Vec3f shift_hue(const cv::Vec3f& bgr, float shift) {
  const float r = bgr[2], g = bgr[1], b = bgr[0];
  const float most = std::max({r, g, b}), range = most - std::min({r, g, b});
  if (range <= 0) return bgr;
  const float rc = (most - r) / range, gc = (most - g) / range, bc = (most - b) / range;
  float h = most == r ? bc - gc : most == g ? 2 + rc - bc : 4 + gc - rc;
  h = std::fmod(h / 6 + 1, 1.0f) + shift;
  h -= std::floor(h);
  const float s = range / most, sector = std::floor(6 * h), f = 6 * h - sector;
  const float p = clamped(most * (1 - s)), q = clamped(most * (1 - s * f)), t = clamped(most * (1 - s * (1 - f)));
  switch (static_cast<int>(sector) % 6) {
    case 0: return {p, t, most};
    case 1: return {p, most, q};
    case 2: return {t, most, p};
    case 3: return {most, q, p};
    case 4: return {most, p, t};
    default: return {q, p, most};
  }
}

/// Pixels of an image as shares of it.
struct Frame {
  double w, h, diagonal;
  explicit Frame(const cv::Mat& image)
      : w(std::max(image.cols - 1, 1)), h(std::max(image.rows - 1, 1)), diagonal(std::hypot(w, h)) {}
  /// From (x, y) of the image to pixel (u, v), in diagonals.
  cv::Point2d from(double x, double y, int u, int v) const { return {(u - x * w) / diagonal, (v - y * h) / diagonal}; }
};

cv::Mat changed(const Jitter& c, const cv::Mat& image) {
  cv::Mat out = image;
  for (const int step : c.order) {
    if (step == 0) out = adjust_brightness(out, c.brightness);
    if (step == 1) out = adjust_contrast(out, c.contrast);
    if (step == 2) out = adjust_saturation(out, c.saturation);
    if (step == 3) out = adjust_hue(out, c.hue);
  }
  return out;
}

cv::Mat changed(const Exposure& c, const cv::Mat& image) {
  const auto gain = static_cast<float>(std::exp2(c.stops)), black = static_cast<float>(c.black);
  return each_value(image, [&](float x) { return gain * x - black; });
}

cv::Mat changed(const Gamma& c, const cv::Mat& image) {
  const auto exponent = static_cast<float>(c.exponent);
  return each_value(image, [&](float x) { return std::pow(std::max(x, 0.0f), exponent); });
}

cv::Mat changed(const Vignetting& c, const cv::Mat& image) {
  const Frame frame(image);
  const auto light = [&](int u, int v) {
    const cv::Point2d d = frame.from(0.5, 0.5, u, v);
    return 1 - 4 * c.fall_off * d.dot(d);
  };
  return each_place(image, light, [](float x, float g) { return x * g; });
}

cv::Mat changed(const Flare& c, const cv::Mat& image) {
  const Frame frame(image);
  struct Ghost {
    double along, radius, amount;  // 0: the lamp, 1: the centre; shares of the flare's
  };
  constexpr Ghost kGhosts[] = {{1.4, 0.35, 0.30}, {1.8, 0.22, 0.40}, {2.3, 0.55, 0.22}};
  const auto light = [&](int u, int v) {
    const cv::Point2d d = frame.from(c.x, c.y, u, v);
    double g = std::exp(-d.dot(d) / (2 * c.radius * c.radius));
    for (const Ghost& ghost : kGhosts) {
      const cv::Point2d e = frame.from(c.x + ghost.along * (0.5 - c.x), c.y + ghost.along * (0.5 - c.y), u, v);
      const double radius = ghost.radius * c.radius;
      g += ghost.amount * smooth_step((1.15 * radius - std::sqrt(e.dot(e))) / (0.3 * radius));
    }
    return std::min(c.amount * g, 1.0);
  };
  return each_place(image, light, [](float x, float g) { return 1 - (1 - x) * (1 - g); });
}

cv::Mat changed(const MotionBlur& c, const cv::Mat& image) {
  const double length = c.length * image.cols, du = length * std::cos(c.angle), dv = length * std::sin(c.angle);
  if (length <= 0) return image;
  // The segment, as points that share their weight among the four pixels around them. Halves are mirrored exactly, or the blur
  // would shift the image.
  const int half = static_cast<int>(std::ceil(length / 2)) + 1, points = 4 * half;
  cv::Mat kernel = cv::Mat::zeros(2 * half + 1, 2 * half + 1, CV_64FC1);
  for (int i = 0; i < points; ++i) {
    const double at = (i + 0.5) / points / 2;  // of the half from the middle to one end
    for (const int side : {-1, 1}) {
      const double x = half + side * at * du, y = half + side * at * dv;
      const int u = static_cast<int>(std::floor(x)), v = static_cast<int>(std::floor(y));
      const double a = x - u, b = y - v;
      kernel.at<double>(v, u) += (1 - a) * (1 - b);
      kernel.at<double>(v, u + 1) += a * (1 - b);
      kernel.at<double>(v + 1, u) += (1 - a) * b;
      kernel.at<double>(v + 1, u + 1) += a * b;
    }
  }
  kernel /= cv::sum(kernel)[0];
  cv::Mat weights, out;
  kernel.convertTo(weights, CV_32F);
  cv::filter2D(image, out, CV_32F, weights, {-1, -1}, 0, cv::BORDER_REFLECT_101);
  return each_value(out, [](float x) { return x; });  // rounding may leave [0, 1]
}

/// Standard deviation 1, from 128 bits.
double near_normal(uint64_t seed, uint64_t i) {
  int sum = 0;
  for (const uint64_t word : {counter_word(seed, 2 * i), counter_word(seed, 2 * i + 1)})
    for (int shift = 0; shift < 64; shift += 16) sum += static_cast<int>(word >> shift & 0xFFFF);
  return (sum - 4 * 65535) / (65536 * std::sqrt(8 / 12.0));
}

cv::Mat changed(const Noise& c, const cv::Mat& image) {
  cv::Mat out(image.size(), image.type());
  const int channels = image.channels();
  for (int v = 0; v < image.rows; ++v)
    for (int u = 0; u < image.cols; ++u)
      for (int k = 0; k < channels; ++k) {
        const uint64_t i = (static_cast<uint64_t>(v) * static_cast<uint64_t>(image.cols) + static_cast<uint64_t>(u)) *
                               static_cast<uint64_t>(channels) +
                           static_cast<uint64_t>(k);
        const int at = u * channels + (channels - 1 - k);  // BGR in memory
        const double x = image.ptr<float>(v)[at], sigma = std::sqrt(c.sigma * c.sigma + c.shot * x);
        out.ptr<float>(v)[at] = clamped(static_cast<float>(x + sigma * near_normal(c.seed, i)));
      }
  return out;
}

cv::Mat changed(const Jpeg& c, const cv::Mat& image) {
  cv::Mat bytes, out;
  image.convertTo(bytes, CV_8U, 255);
  std::vector<uchar> file;
  if (!cv::imencode(".jpg", bytes, file, {cv::IMWRITE_JPEG_QUALITY, c.quality}))
    throw Error(ErrorCode::unsupported, "OpenCV cannot encode JPEG");
  cv::imdecode(file, image.channels() == 1 ? cv::IMREAD_GRAYSCALE : cv::IMREAD_COLOR).convertTo(out, CV_32F, 1 / 255.0);
  return out;
}

cv::Mat changed(const Shadow& c, const cv::Mat& image) {
  const Frame frame(image);
  const double cosine = std::cos(c.angle), sine = std::sin(c.angle);
  const auto light = [&](int u, int v) {
    const cv::Point2d d = frame.from(c.x, c.y, u, v);
    const double along = std::abs(cosine * d.x + sine * d.y) - c.half_length;
    const double across = std::abs(cosine * d.y - sine * d.x) - c.half_width;
    // Distance from the rectangle, negative inside.
    const double outside = std::hypot(std::max(along, 0.0), std::max(across, 0.0)) + std::min(std::max(along, across), 0.0);
    return 1 - c.darkness * smooth_step(0.5 - outside / std::max(c.softness, 1e-9));
  };
  return each_place(image, light, [](float x, float g) { return x * g; });
}

double wave(double turns) { return std::sin(2 * std::numbers::pi * turns); }

cv::Mat changed(const Haze& c, const cv::Mat& image) {
  const Frame frame(image);
  const auto clear = [&](int u, int v) {
    return std::exp(-c.density * 0.5 * (1 + wave(c.kx * u / frame.w + c.ky * v / frame.h + c.phase)));
  };
  return each_place(image, clear, [light = static_cast<float>(c.light)](float x, float g) { return x * g + light * (1 - g); });
}

cv::Mat changed(const Flicker& c, const cv::Mat& image) {
  const Frame frame(image);
  const auto gain = [&](int, int v) { return 1 + c.amount * wave(c.periods * v / frame.h + c.phase); };
  return each_place(image, gain, [](float x, float g) { return x * g; });
}

cv::Mat changed(const Banding& c, const cv::Mat& image) {
  std::vector<double> columns, rows;
  for (int u = 0; u < image.cols; ++u) columns.push_back(c.sigma * near_normal(c.seed, static_cast<uint64_t>(u)));
  for (int v = 0; v < image.rows; ++v) rows.push_back(c.sigma * near_normal(c.seed, static_cast<uint64_t>(image.cols + v)));
  const auto offset = [&](int u, int v) { return columns[static_cast<size_t>(u)] + rows[static_cast<size_t>(v)]; };
  return each_place(image, offset, [](float x, float g) { return x + g; });
}

cv::Mat changed(const ToneMap& c, const cv::Mat& image) {
  cv::Mat base(image.size(), CV_32FC1);
  for (int v = 0; v < image.rows; ++v)
    for (int u = 0; u < image.cols; ++u)
      base.at<float>(v, u) = image.channels() == 1 ? image.at<float>(v, u) : grey(image.at<cv::Vec3f>(v, u));
  cv::GaussianBlur(base, base, {}, std::max(c.radius * Frame(image).diagonal, 0.5), 0, cv::BORDER_REFLECT_101);
  const auto gain = [&](int u, int v) { return std::pow(0.5 / (0.05 + base.at<float>(v, u)), c.amount); };
  return each_place(image, gain, [](float x, float g) { return x * g; });
}

using Json = nlohmann::ordered_json;

Json parameters(const Haze& c) {
  return {{"change", "haze"}, {"density", c.density}, {"light", c.light}, {"kx", c.kx}, {"ky", c.ky}, {"phase", c.phase}};
}
Json parameters(const Flicker& c) {
  return {{"change", "flicker"}, {"amount", c.amount}, {"periods", c.periods}, {"phase", c.phase}};
}
Json parameters(const Banding& c) { return {{"change", "banding"}, {"sigma", c.sigma}, {"seed", c.seed}}; }
Json parameters(const ToneMap& c) { return {{"change", "tone_map"}, {"amount", c.amount}, {"radius", c.radius}}; }

Json parameters(const Jitter& c) {
  return {{"change", "jitter"},     {"order", c.order},           {"brightness", c.brightness},
          {"contrast", c.contrast}, {"saturation", c.saturation}, {"hue", c.hue}};
}
Json parameters(const Exposure& c) { return {{"change", "exposure"}, {"stops", c.stops}, {"black", c.black}}; }
Json parameters(const Gamma& c) { return {{"change", "gamma"}, {"exponent", c.exponent}}; }
Json parameters(const Vignetting& c) { return {{"change", "vignetting"}, {"fall_off", c.fall_off}}; }
Json parameters(const Flare& c) {
  return {{"change", "flare"}, {"x", c.x}, {"y", c.y}, {"amount", c.amount}, {"radius", c.radius}};
}
Json parameters(const MotionBlur& c) { return {{"change", "motion_blur"}, {"length", c.length}, {"angle", c.angle}}; }
Json parameters(const Noise& c) { return {{"change", "noise"}, {"sigma", c.sigma}, {"shot", c.shot}, {"seed", c.seed}}; }
Json parameters(const Jpeg& c) { return {{"change", "jpeg"}, {"quality", c.quality}}; }
Json parameters(const Shadow& c) {
  return {{"change", "shadow"},
          {"x", c.x},
          {"y", c.y},
          {"angle", c.angle},
          {"half_length", c.half_length},
          {"half_width", c.half_width},
          {"softness", c.softness},
          {"darkness", c.darkness}};
}

}  // namespace

cv::Mat adjust_brightness(const cv::Mat& image, double factor) {
  return each_value(image, [blend = Blend(factor)](float x) { return blend(x, 0); });
}

cv::Mat adjust_contrast(const cv::Mat& image, double factor) {
  double sum = 0;
  for (int v = 0; v < image.rows; ++v)
    for (int u = 0; u < image.cols; ++u) sum += image.channels() == 1 ? image.at<float>(v, u) : grey(image.at<cv::Vec3f>(v, u));
  const auto mean = static_cast<float>(sum / static_cast<double>(std::max<size_t>(image.total(), 1)));
  return each_value(image, [&, blend = Blend(factor)](float x) { return blend(x, mean); });
}

cv::Mat adjust_saturation(const cv::Mat& image, double factor) {
  if (image.channels() == 1) return image;
  return each_colour(image, [blend = Blend(factor)](const cv::Vec3f& x) {
    const float g = grey(x);
    return cv::Vec3f(blend(x[0], g), blend(x[1], g), blend(x[2], g));
  });
}

cv::Mat adjust_hue(const cv::Mat& image, double shift) {
  if (image.channels() == 1) return image;
  return each_colour(image, [&](const cv::Vec3f& x) { return shift_hue(x, static_cast<float>(shift)); });
}

cv::Mat apply_change(const Change& change, const cv::Mat& image) {
  return std::visit([&](const auto& c) { return changed(c, image); }, change);
}

cv::Mat changed_image(const cv::Mat& image, std::span<const Change> changes) {
  if (changes.empty()) return image;
  if (image.depth() != CV_8U && image.depth() != CV_16U)
    throw Error(ErrorCode::unsupported,
                "appearance changes need 8-bit or 16-bit images: the white level of float images is unknown");
  const double white = image.depth() == CV_8U ? 255 : 65535;
  cv::Mat unit, out;
  image.convertTo(unit, CV_32F, 1 / white);
  for (const Change& change : changes) unit = apply_change(change, unit);
  unit.convertTo(out, image.depth(), white);
  return out;
}

nlohmann::ordered_json to_json(const Change& change) {
  return std::visit([](const auto& c) { return parameters(c); }, change);
}

double smooth_step(double x) {
  const double t = std::clamp(x, 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

uint64_t counter_word(uint64_t seed, uint64_t n) {
  uint64_t z = seed + (n + 1) * 0x9E3779B97F4A7C15u;
  z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
  z = (z ^ z >> 27) * 0x94D049BB133111EBu;
  return z ^ z >> 31;
}

}  // namespace iclk
