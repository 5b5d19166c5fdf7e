#include <iclk/align/solver/mask.h>

#include <algorithm>
#include <cmath>

#include <iclk/shaders/shared.h>

namespace iclk::internal {

std::vector<float> sparse_mask(const Features& features, std::span<const FeatureCheck> checks, const Camera& camera,
                               int level) {
  const int n = features.size();
  const int width = camera.width >> level, height = camera.height >> level;
  const auto scale = static_cast<float>(std::ldexp(1.0, -level));
  // The present owner of each pixel of the level. Single precision, so that ties are decided as on the device.
  std::vector<int> owner(static_cast<size_t>(width) * height, -1);
  std::vector<float> distance(owner.size());
  const auto centre = [&](int i) {
    return std::pair((static_cast<float>(features.uv[i].x()) + 0.5f) * scale - 0.5f,
                     (static_cast<float>(features.uv[i].y()) + 0.5f) * scale - 0.5f);
  };
  const auto for_each_pixel = [&](int i, auto&& visit) {
    const auto [cu, cv] = centre(i);
    const int u0 = static_cast<int>(std::floor(cu)) - ICLK_PATCH_BEFORE,
              v0 = static_cast<int>(std::floor(cv)) - ICLK_PATCH_BEFORE;
    for (int row = 0; row < ICLK_PATCH; ++row)
      for (int column = 0; column < ICLK_PATCH; ++column) {
        const int u = u0 + column, v = v0 + row;
        if (u >= 0 && v >= 0 && u < width && v < height)
          visit(static_cast<size_t>(v) * width + u, row * ICLK_PATCH + column, u - cu, v - cv);
      }
  };
  for (int i = 0; i < n; ++i) {
    if (checks[i] != FeatureCheck::ok) continue;
    for_each_pixel(i, [&](size_t pixel, int, float du, float dv) {
      const float d = du * du + dv * dv;
      if (owner[pixel] < 0 || d < distance[pixel]) {  // strictly nearer; for ties the lower index stays
        owner[pixel] = i;
        distance[pixel] = d;
      }
    });
  }
  std::vector<float> mask(static_cast<size_t>(n) * ICLK_PATCH_AREA, 0.0f);
  for (int i = 0; i < n; ++i) {
    if (checks[i] != FeatureCheck::ok) continue;
    const auto q = static_cast<float>(features.inverse_depth[i]);
    for_each_pixel(i, [&](size_t pixel, int k, float, float) {
      if (owner[pixel] == i) mask[static_cast<size_t>(i) * ICLK_PATCH_AREA + k] = q;
    });
  }
  return mask;
}

Map half_inverse_depth(const Map& finer) {
  Map half(finer.width / 2, finer.height / 2);
  for (int v = 0; v < half.height; ++v)
    for (int u = 0; u < half.width; ++u) {
      float sum = 0, least = 1e30f, most = 0;
      int valid = 0;
      for (int k = 0; k < 4; ++k) {
        const float q = finer.at(2 * u + (k & 1), 2 * v + (k >> 1));
        if (q <= 0) continue;
        sum += q;
        least = std::min(least, q);
        most = std::max(most, q);
        ++valid;
      }
      half.at(u, v) = valid && most <= 1.1f * least ? sum / static_cast<float>(valid) : 0.0f;
    }
  return half;
}

}  // namespace iclk::internal
