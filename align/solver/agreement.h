#pragma once
#include <span>

#include <iclk/align/solver/normal_equations.h>

namespace iclk::internal {

/// What the gradients of both images say of the pose together, at the finest level where the iterations ended. J0 is the
/// template's Jacobian, J1 the same with the gradient of the warped target:
///
///   cross = sum w (J0^T J1 + J1^T J0) / 2,    target = sum w J1^T J1        over the visible mask pixels
///
/// Noise and the target's own content are in J0^T J0 as if they were texture; of `cross` they are no part, because the other
/// image does not have them. So cross is the information about the pose that both images confirm, and in every direction of
/// the pose its ratio to the mean of both images' own is the correlation of their gradients: 1 where the images match, 0 where
/// there is no common texture (edges of one direction in noise) or the images do not match.
///
/// Residuals of neighbouring pixels are wrong together: a learned map sees the same noise in all that its receptive field
/// covers, interpolation and depth are wrong for the whole of a patch. With s = sum w r grad f0 over a patch (in dense mode:
/// over 64 pixels of a row), sum |s|^2 over the patches is what sum w^2 r^2 |grad f0|^2 over the pixels would be, were the
/// pixels independent; the ratio is by what the variance of the pose is larger than that of so many independent pixels.
struct Agreement {
  Matrix6d cross = Matrix6d::Zero();
  Matrix6d target = Matrix6d::Zero();
  double patch_scores = 0;  ///< sum over the patches of |sum w r grad f0|^2
  double pixel_scores = 0;  ///< sum over their pixels of |w r grad f0|^2
  double patches = 0;       ///< that have a pixel in the sums

  Agreement& operator+=(const Agreement& other);
  /// The ratio, for `parameters` estimated from these patches; 1 at least.
  double variance_ratio(double parameters) const;
};

/// weights: one an element, empty = 1.
Agreement agreement(const Template& pixels, const Map& f1, const Camera& level_camera, const Point& at,
                    std::span<const float> weights);

}  // namespace iclk::internal
