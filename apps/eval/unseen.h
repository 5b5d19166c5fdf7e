#pragma once
#include <cstdint>

#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>

namespace iclk {

// The family `unseen` of sealed sets (docs/results/sealed.md): no model is trained on it, and nothing is chosen with it. Images
// and lengths are as in apps/eval/appearance.h.

/// x (1 - darkness m), where m is 0 to 1, by clouds: two octaves of smooth random values on a lattice of `cells` per diagonal.
struct Clouds {
  double darkness = 0, cells = 3;
  uint64_t seed = 0;
};

/// `count` round drops on the lens. Inside, the image is blurred by half the drop's radius and a little brighter:
/// (1 - m) x + m (0.8 blurred + 0.15), m = amount at the middle, 0 at the rim. Radii are 0.01 to 0.05 diagonals.
struct Droplets {
  double amount = 0;
  int count = 20;
  uint64_t seed = 0;
};

/// Another sensor's colours: (1 - amount) x + amount M x, where the rows of M are random, may be negative, and sum to 1. Images
/// of one channel stay as they are.
struct ChannelMix {
  double amount = 0;
  uint64_t seed = 0;
};

/// x + amount (x - blurred x), the blur of standard deviation `radius`: the halos of a camera that sharpens.
struct Sharpen {
  double amount = 0, radius = 0.003;
};

cv::Mat changed(const Clouds& change, const cv::Mat& image);
cv::Mat changed(const Droplets& change, const cv::Mat& image);
cv::Mat changed(const ChannelMix& change, const cv::Mat& image);
cv::Mat changed(const Sharpen& change, const cv::Mat& image);

nlohmann::ordered_json parameters(const Clouds& change);
nlohmann::ordered_json parameters(const Droplets& change);
nlohmann::ordered_json parameters(const ChannelMix& change);
nlohmann::ordered_json parameters(const Sharpen& change);

}  // namespace iclk
