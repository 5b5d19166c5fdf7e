#pragma once
#include <vector>

#include <Eigen/Core>

#include <iclk/align/features.h>
#include <iclk/align/image.h>
#include <iclk/align/pyramid.h>

namespace iclk {

/// How wrong a sensor's depths are: standard deviation of an inverse depth q, constant + relative q.
struct DepthNoise {
  double constant = 0;  ///< 1 / unit of length: of stereo and structured light, whose depths get worse with their square
  double relative = 0;  ///< of q

  double sigma(double q) const { return constant + relative * q; }
};

struct CornerSettings {
  int count = 200;        ///< features at most
  int border = 16;        ///< px that stay free
  int distance = 8;       ///< px between two features
  double texture = 1e-5;  ///< least smaller eigenvalue of the mean gradient matrix, (grey / px)^2
  double spread = 0.05;   ///< of its depth, that a patch's depths may have; beyond it is a depth edge, and taken last
};

/// The tracker's own choice, beside detect_features() of iclk/session/detect.h: features of a frame where its depth is known:
/// per cell of a lattice the places with the most texture, round by round, until there are enough. `grey` is level 0; `depth`
/// r32f of the same size, 0 or NaN where there is none; `mask` r8 of the same size, 0 where nothing is to be looked at: no
/// patch reaches into that. It may be empty. Each feature gets the sensor's sigma where `noise` says one.
Features detect_corners(const Map& grey, const ImageView& depth, const ImageView& mask, const DepthNoise& noise,
                        const CornerSettings& settings);

/// As many more places with texture, in the same way, where no depth is known, away from those that are `taken`. `depth` may
/// be empty.
std::vector<Eigen::Vector2d> detect_seeds(const Map& grey, const ImageView& depth, const ImageView& mask,
                                          const std::vector<Eigen::Vector2d>& taken, int count, const CornerSettings& settings);

}  // namespace iclk
