#pragma once
#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>

namespace iclk {

/// Sparse features of the reference image: N pixels and their inverse depths q = 1 / z (z along the optical axis, scene unit).
struct Features {
  std::vector<Eigen::Vector2d> uv;    ///< N pixels of level 0
  std::vector<double> inverse_depth;  ///< N
  /// N standard deviations of inverse_depth, or empty; 0 and NaN are unknown. The refinement weighs by them and has
  /// them in its covariance; where they are unknown it estimates one from its residuals.
  std::vector<double> inverse_depth_sigma;

  int size() const { return static_cast<int>(uv.size()); }
};

/// Why a feature takes no part. Features are rejected one by one; the others go on.
enum class FeatureCheck : uint8_t {
  ok,
  not_finite,     ///< u, v or the depth is NaN or infinite
  no_depth,       ///< inverse depth <= 0: no measurement, or behind the camera
  outside_image,  ///< the 8x8 patch at level 0, first pixel floor(uv) - 3, is not inside the image
};
const char* name(FeatureCheck check);

/// One verdict a feature. Throws Error(invalid_argument) only if the vectors' lengths differ, and for a sigma that is negative
/// or infinite.
std::vector<FeatureCheck> check_features(const Features& features, const Camera& camera);

/// How many are ok.
int count_ok(std::span<const FeatureCheck> checks);

/// "38 of 50 features usable (9 no_depth, 3 outside_image)".
std::string summary(std::span<const FeatureCheck> checks);

}  // namespace iclk
