#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <variant>

#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>

#include "apps/eval/unseen.h"

namespace iclk {

// What light, lenses and sensors do to an image: pure functions with all parameters in sight, so that another program (a
// trainer) can do the same. An image is CV_32FC3 (BGR) or CV_32FC1 in [0, 1], and so is the result. None moves a pixel: what is
// true of a pair's pose stays true. Lengths are shares of the image, so that they mean the same at any size: x and y of the
// centres of the first and the last pixel are 0 and 1; other lengths are in diagonals, hypot(width - 1, height - 1) px.

// Colour jitter as torchvision.transforms.ColorJitter does it on float tensors: clamped to [0, 1] after each step, nothing
// rounded in between. Grey is 0.2989 R + 0.587 G + 0.114 B. Hue and saturation leave single-channel images as they are.
cv::Mat adjust_brightness(const cv::Mat& image, double factor);  ///< factor x; 1 keeps the image
cv::Mat adjust_contrast(const cv::Mat& image, double factor);    ///< factor x + (1 - factor) mean of grey
cv::Mat adjust_saturation(const cv::Mat& image, double factor);  ///< factor x + (1 - factor) grey
cv::Mat adjust_hue(const cv::Mat& image, double shift);          ///< turns of the colour circle, [-0.5, 0.5]

/// The four in a drawn order.
struct Jitter {
  std::array<int, 4> order = {0, 1, 2, 3};  ///< 0 brightness, 1 contrast, 2 saturation, 3 hue
  double brightness = 1, contrast = 1, saturation = 1, hue = 0;
};

/// 2^stops x - black, clipped: bright parts go white when positive, dark ones black when negative.
struct Exposure {
  double stops = 0, black = 0;
};

/// x^exponent.
struct Gamma {
  double exponent = 1;
};

/// x (1 - fall_off (2 r)^2) at r diagonals from the centre: a corner loses the share fall_off, the centre nothing.
struct Vignetting {
  double fall_off = 0;
};

/// Stray light g of a lamp at (x, y), which may lie outside: 1 - (1 - x) (1 - g). g is a glow of standard deviation `radius`
/// and three ghosts, discs on the line from the lamp through the centre.
struct Flare {
  double x = 0, y = 0;
  double amount = 0;  ///< g at the lamp
  double radius = 0.1;
};

/// The mean along a segment that is centred on the pixel. Borders are mirrored.
struct MotionBlur {
  double length = 0;  ///< of the image's width
  double angle = 0;   ///< rad, from x towards y
};

/// x + n, var n = sigma^2 + shot x. n is near normal: the sum of eight 16-bit numbers, whose bits are those of
/// counter_word(seed, 2 i) and counter_word(seed, 2 i + 1), i = (row * width + column) * channels + channel, red first.
struct Noise {
  double sigma = 0, shot = 0;
  uint64_t seed = 0;
};

/// There and back through libjpeg, colour at half resolution (4:2:0).
struct Jpeg {
  int quality = 100;
};

/// x (1 - darkness) inside a rectangle around (x, y), turned by `angle`; its edge is a smooth step of width `softness`.
struct Shadow {
  double x = 0.5, y = 0.5;
  double angle = 0;                            ///< rad, of its longer side
  double half_length = 0.3, half_width = 0.1;  ///< diagonals, like softness
  double softness = 0.01;
  double darkness = 0;
};

// The family `adverse`; in the sealed test of 0.1.0 it was `unseen` (docs/results/sealed.md).

/// x e^-b + light (1 - e^-b), b = density (1 + sin(2 pi (k . (x, y) + phase))) / 2: haze that is thicker here than there.
struct Haze {
  double density = 0, light = 0.85;
  double kx = 0, ky = 0, phase = 0;  ///< periods across the image and down it, turns
};

/// x (1 + amount sin(2 pi (periods y + phase))): a lamp's flicker under a rolling shutter.
struct Flicker {
  double amount = 0, periods = 1, phase = 0;
};

/// x + n of the column + n of the row, each near normal with standard deviation sigma, as Noise's of counter_word(seed, 2 i)
/// and its next, i = column, then width + row.
struct Banding {
  double sigma = 0;
  uint64_t seed = 0;
};

/// x (0.5 / (0.05 + b))^amount, b the blurred grey (standard deviation `radius`): local tone mapping.
struct ToneMap {
  double amount = 0, radius = 0.08;
};

using Change = std::variant<Jitter, Exposure, Gamma, Vignetting, Flare, MotionBlur, Noise, Jpeg, Shadow, Haze, Flicker, Banding,
                            ToneMap, Clouds, Droplets, ChannelMix, Sharpen>;

cv::Mat apply_change(const Change& change, const cv::Mat& image);

/// The changes one after another on an image of load_image, whose type the result has, rounded to its nearest value. No
/// changes: the image itself. Throws Error(unsupported) for images of floats: what is white in them is not known.
cv::Mat changed_image(const cv::Mat& image, std::span<const Change> changes);

/// {"change": "exposure", "stops": 1.5, "black": 0}: every parameter by its name.
nlohmann::ordered_json to_json(const Change& change);

/// 0 below 0, 1 above 1, 3 x^2 - 2 x^3 between.
double smooth_step(double x);

/// Word n of the stream `seed` of SplitMix64: its output n + 1 calls after it was seeded. Integer arithmetic modulo 2^64:
///   z = seed + (n + 1) 0x9E3779B97F4A7C15;  z = (z ^ z >> 30) 0xBF58476D1CE4E5B9;  z = (z ^ z >> 27) 0x94D049BB133111EB;
///   z ^ z >> 31
uint64_t counter_word(uint64_t seed, uint64_t n);

}  // namespace iclk
