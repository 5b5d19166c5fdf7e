#pragma once
#include <span>

#include <Eigen/Core>

#include <iclk/refine/recolouring.h>

namespace iclk::internal {

/// Sums over the pixels of an aligned patch, for Recolouring: T are the grey values of the reference, C = (R, G, B) the colours
/// of the target, each minus its mean over the patch. All zero: no information.
struct ColourSums {
  double TT = 0;
  Eigen::Vector3d TC = Eigen::Vector3d::Zero();
  Eigen::Matrix3d CC = Eigen::Matrix3d::Zero();
};

/// Finds the weights w by least squares over all patches. Each patch p has a gain g_p and a robust weight rho_p:
///
///   min sum_p rho_p |T_p - g_p w . C_p|^2 + noise^2 |w - luma|^2 sum_p rho_p g_p^2 64
///
/// The second term is the noise of the colours; in a grey scene it keeps w at luma. w is also luma with fewer than 8
/// informative patches, and if w would explain less than a twentieth of the variation that luma leaves unexplained.
Recolouring recolour(std::span<const ColourSums> patches);

}  // namespace iclk::internal
