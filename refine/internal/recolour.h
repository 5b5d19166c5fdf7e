#pragma once
#include <span>

#include <Eigen/Core>

#include <iclk/refine/recolouring.h>

namespace iclk::internal {

/// What an aligned patch says of the target's colours: sums over its pixels of the reference's grey values T and the target's
/// colours C = (R, G, B), each less its mean over the patch. All zero: nothing.
struct ColourSums {
  double TT = 0;
  Eigen::Vector3d TC = Eigen::Vector3d::Zero();
  Eigen::Matrix3d CC = Eigen::Matrix3d::Zero();
};

/// Least squares over all patches with a gain of their own, patches that fit badly weighing less:
///   min sum_p rho_p |T_p - g_p w . C_p|^2 + noise^2 |w - luma|^2 sum_p rho_p g_p^2 64
/// The second term is the noise of the colours: with none but grey to go by, w stays luma. So it does with fewer than 8 patches
/// that say something, and where less than a twentieth of what luma leaves unexplained would be won.
Recolouring recolour(std::span<const ColourSums> patches);

}  // namespace iclk::internal
