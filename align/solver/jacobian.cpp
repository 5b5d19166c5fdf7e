#include <iclk/align/solver/jacobian.h>

#include <cmath>

#include <iclk/shaders/shared.h>

namespace iclk::internal {
namespace {

TemplatePixel template_pixel(const Map& f0, int u, int v, float q) {
  return {static_cast<float>(u),
          static_cast<float>(v),
          q,
          f0.at(u, v),
          static_cast<float>(f0.gradient_u(u, v)),
          static_cast<float>(f0.gradient_v(u, v))};
}

}  // namespace

Template sparse_template(const Map& f0, const Features& features, std::span<const float> mask, int level) {
  Template out(mask.size());
  const auto scale = static_cast<float>(std::ldexp(1.0, -level));
  for (size_t k = 0; k < mask.size(); ++k) {
    if (mask[k] == 0) continue;
    const Eigen::Vector2d& uv = features.uv[k / ICLK_PATCH_AREA];
    const int pixel = static_cast<int>(k % ICLK_PATCH_AREA);
    const int u = static_cast<int>(std::floor((static_cast<float>(uv.x()) + 0.5f) * scale - 0.5f)) - ICLK_PATCH_BEFORE +
                  pixel % ICLK_PATCH;
    const int v = static_cast<int>(std::floor((static_cast<float>(uv.y()) + 0.5f) * scale - 0.5f)) - ICLK_PATCH_BEFORE +
                  pixel / ICLK_PATCH;
    out[k] = template_pixel(f0, u, v, mask[k]);
  }
  return out;
}

Template dense_template(const Map& f0, const Map& inverse_depth) {
  Template out(f0.data.size());
  for (int v = 0; v < f0.height; ++v)
    for (int u = 0; u < f0.width; ++u)
      if (const float q = inverse_depth.at(u, v); q > 0)
        out[static_cast<size_t>(v) * f0.width + u] = template_pixel(f0, u, v, q);
  return out;
}

}  // namespace iclk::internal
