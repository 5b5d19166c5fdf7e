#pragma once
#include <span>

#include <iclk/align/solver/normal_equations.h>

namespace iclk::internal {

/// Information about the pose that the gradients of both images share, at the final pose of the finest level. J0 is the
/// Jacobian of the template, J1 the same with the gradient of the warped target:
///
///   cross = sum w (J0^T J1 + J1^T J0) / 2,    target = sum w J1^T J1        over the visible mask pixels
///
/// J0^T J0 counts noise, and content that only one image has, as if it were texture. `cross` does not, because the other image
/// lacks it: cross is the information that both images confirm. Divided by the mean of both images' own information, it is the
/// correlation of their gradients in each direction of the pose. It is 1 where the images match. It is 0 where they do not, or
/// where they share no texture (edges of one direction in noise).
///
/// Residuals of neighbouring pixels have correlated errors. A learned map spreads noise over its receptive field; errors of
/// interpolation and depth affect a whole patch. Let s = sum w r grad f0 over a patch (in dense mode: over 64 pixels of a row).
/// For independent pixels, sum |s|^2 over the patches would equal sum w^2 r^2 |grad f0|^2 over the pixels. The ratio is the
/// factor by which the correlation increases the variance of the pose.
struct Agreement {
  Matrix6d cross = Matrix6d::Zero();
  Matrix6d target = Matrix6d::Zero();
  double patch_scores = 0;  ///< sum over the patches of |sum w r grad f0|^2
  double pixel_scores = 0;  ///< sum over their pixels of |w r grad f0|^2
  double patches = 0;       ///< the number of patches with a pixel in the sums

  Agreement& operator+=(const Agreement& other);
  /// The ratio, for `parameters` parameters that were estimated from these patches; at least 1.
  double variance_ratio(double parameters) const;
};

/// Computes the sums. `weights`: one per element; empty: 1.
Agreement agreement(const Template& pixels, const Map& f1, const Camera& level_camera, const Point& at,
                    std::span<const float> weights);

}  // namespace iclk::internal
