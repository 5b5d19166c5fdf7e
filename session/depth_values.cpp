#include <iclk/session/depth_values.h>

#include <algorithm>
#include <cmath>

namespace iclk {
namespace {

constexpr float kHalfLargest = 65504, kBeyondAll = 1e9f;
constexpr double kShare = 0.02;
constexpr size_t kPeak = 4;  // times the number of pixels of the next value

/// The two largest values and their numbers of pixels.
struct Largest {
  float first = 0, second = 0;
  size_t of_first = 0, of_second = 0;
};

Largest largest(std::span<const float> depths) {
  Largest l;
  for (const float z : depths) {
    if (z > l.first)
      l = {z, l.first, 1, l.of_first};
    else if (z == l.first)
      ++l.of_first;
    else if (z > l.second)
      l.second = z, l.of_second = 1;
    else
      l.of_second += z == l.second;
  }
  return l;
}

}  // namespace

size_t keep_measured(std::span<float> depths, double most) {
  for (float& z : depths)
    if (!(std::isfinite(z) && z > 0 && z < kBeyondAll && z != kHalfLargest && static_cast<double>(z) < most)) z = 0;
  const Largest l = largest(depths);
  const bool fills = static_cast<double>(l.of_first) > kShare * static_cast<double>(depths.size());
  if (l.second > 0 && fills && l.of_first > kPeak * l.of_second) std::replace(depths.begin(), depths.end(), l.first, 0.0f);
  return depths.size() - static_cast<size_t>(std::count(depths.begin(), depths.end(), 0.0f));
}

}  // namespace iclk
