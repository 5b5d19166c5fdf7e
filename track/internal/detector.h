#pragma once
#include <vector>

#include <Eigen/Core>

#include <iclk/align/features.h>
#include <iclk/align/image.h>
#include <iclk/align/pyramid.h>

namespace iclk::internal {

inline constexpr double kCornerDistance = 8;  ///< px between two features

/// The tracker's own choice, beside detect_features() of iclk/session/detect.h: features of a frame where its depth is known:
/// per cell of a lattice the places with the most texture, round by round, until there are `count`; `border` px stay free.
/// `grey` is level 0; `depth` r32f of the same size, 0 or NaN where there is none; `mask` r8 of the same size, 0 where nothing
/// is to be looked at: no patch reaches into that. It may be empty.
Features detect_corners(const Map& grey, const ImageView& depth, const ImageView& mask, int count, int border);

/// As many more places with texture, in the same way, where no depth is known, away from those that are `taken`. `depth` may
/// be empty.
std::vector<Eigen::Vector2d> detect_seeds(const Map& grey, const ImageView& depth, const ImageView& mask,
                                          const std::vector<Eigen::Vector2d>& taken, int count, int border);

/// 0 where there is none.
double depth_at(const ImageView& depth, int u, int v);

}  // namespace iclk::internal
