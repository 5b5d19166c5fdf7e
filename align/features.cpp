#include <iclk/align/features.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <sstream>

#include <iclk/engine/error.h>
#include <iclk/shaders/shared.h>

namespace iclk {

const char* name(FeatureCheck check) {
  constexpr std::array<const char*, 4> names = {"ok", "not_finite", "no_depth", "outside_image"};
  return names[static_cast<size_t>(check)];
}

std::vector<FeatureCheck> check_features(const Features& features, const Camera& camera) {
  const size_t n = features.uv.size();
  if (features.inverse_depth.size() != n)
    throw Error(ErrorCode::invalid_argument,
                std::to_string(n) + " feature pixels but " + std::to_string(features.inverse_depth.size()) + " inverse depths");
  if (!features.inverse_depth_sigma.empty() && features.inverse_depth_sigma.size() != n)
    throw Error(ErrorCode::invalid_argument, std::to_string(n) + " feature pixels but " +
                                                 std::to_string(features.inverse_depth_sigma.size()) + " inverse depth sigmas");
  std::vector<FeatureCheck> checks(n, FeatureCheck::ok);
  for (size_t i = 0; i < n; ++i) {
    const Eigen::Vector2d& uv = features.uv[i];
    const double q = features.inverse_depth[i],
                 sigma = features.inverse_depth_sigma.empty() ? 0 : features.inverse_depth_sigma[i];
    if (std::isfinite(q) && q > 0 && (sigma < 0 || std::isinf(sigma)))
      throw Error(ErrorCode::invalid_argument, "feature " + std::to_string(i) + ": the sigma of its inverse depth is " +
                                                   std::to_string(sigma) + "; it must be positive and finite, or 0 if unknown");
    // Every infinite depth (q = 0) is "no depth"; an infinite q is a depth of zero, which no camera measures.
    if (!uv.allFinite() || !std::isfinite(q)) {
      checks[i] = FeatureCheck::not_finite;
    } else if (q <= 0) {
      checks[i] = FeatureCheck::no_depth;
    } else {
      const double u = std::floor(uv.x()) - ICLK_PATCH_BEFORE, v = std::floor(uv.y()) - ICLK_PATCH_BEFORE;
      if (u < 0 || v < 0 || u + ICLK_PATCH > camera.width || v + ICLK_PATCH > camera.height)
        checks[i] = FeatureCheck::outside_image;
    }
  }
  return checks;
}

int count_ok(std::span<const FeatureCheck> checks) {
  return static_cast<int>(std::count(checks.begin(), checks.end(), FeatureCheck::ok));
}

std::string summary(std::span<const FeatureCheck> checks) {
  std::ostringstream out;
  out << count_ok(checks) << " of " << checks.size() << " features usable";
  const char* separator = " (";
  for (FeatureCheck c : {FeatureCheck::not_finite, FeatureCheck::no_depth, FeatureCheck::outside_image})
    if (const auto n = std::count(checks.begin(), checks.end(), c); n > 0) {
      out << separator << n << " " << name(c);
      separator = ", ";
    }
  if (separator[0] == ',') out << ")";
  return out.str();
}

}  // namespace iclk
