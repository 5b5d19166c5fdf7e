#include <iclk/align/solver/weights.h>

#include <algorithm>
#include <cmath>

namespace iclk::internal {

float mad_scale(std::span<const float> residuals) {
  std::vector<float> magnitude;
  magnitude.reserve(residuals.size());
  for (float r : residuals)
    if (std::isfinite(r)) magnitude.push_back(std::abs(r));
  if (magnitude.empty()) return 0;
  const auto middle = magnitude.begin() + static_cast<std::ptrdiff_t>((magnitude.size() - 1) / 2);
  std::nth_element(magnitude.begin(), middle, magnitude.end());
  return std::max(1.4826f * *middle, 1e-3f);
}

float robust_weight(Robust robust, float r, float scale) {
  switch (robust) {
    case Robust::unit: return 1;
    case Robust::huber: return std::min(1.0f, 1.345f * scale / std::max(std::abs(r), 1e-12f));
    case Robust::tukey: {
      const float x = r / (4.685f * scale), y = std::max(1 - x * x, 0.0f);
      return y * y;
    }
    case Robust::cauchy: {
      const float x = r / (2.3849f * scale);
      return 1 / (1 + x * x);
    }
  }
  return 1;
}

std::vector<float> robust_weights(Robust robust, std::span<const float> residuals, float scale) {
  std::vector<float> w(residuals.size());
  std::transform(residuals.begin(), residuals.end(), w.begin(),
                 [&](float r) { return std::isfinite(r) ? robust_weight(robust, r, scale) : 0.0f; });
  return w;
}

}  // namespace iclk::internal
