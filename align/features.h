#pragma once
#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>

namespace iclk {

/// N sparse features of the reference image: pixels and inverse depths q = 1 / z (z along the optical axis, in scene units).
struct Features {
  std::vector<Eigen::Vector2d> uv;    ///< N pixels of level 0
  std::vector<double> inverse_depth;  ///< N
  /// N standard deviations of inverse_depth, or empty; 0 and NaN: unknown. The refinement uses them as weights and in its
  /// covariance. Where they are unknown, it estimates one from its residuals.
  std::vector<double> inverse_depth_sigma;

  int size() const { return static_cast<int>(uv.size()); }
};

/// Whether a feature can be used, and if not, why. The other features are used.
enum class FeatureCheck : uint8_t {
  ok,
  not_finite,     ///< u, v or the depth is NaN or infinite
  no_depth,       ///< inverse depth <= 0: no measurement, or behind the camera
  outside_image,  ///< the 8x8 patch at level 0, first pixel floor(uv) - 3, is not inside the image
};
const char* name(FeatureCheck check);

/// Returns one verdict per feature. Throws Error(invalid_argument) if the lengths of the vectors differ, and for a sigma that
/// is negative or infinite.
std::vector<FeatureCheck> check_features(const Features& features, const Camera& camera);

/// The number of usable features.
int count_ok(std::span<const FeatureCheck> checks);

/// A summary, for example "38 of 50 features usable (9 no_depth, 3 outside_image)".
std::string summary(std::span<const FeatureCheck> checks);

}  // namespace iclk
