#pragma once
#include <vector>

#include <Eigen/Core>

#include <iclk/align/features.h>
#include <iclk/align/image.h>
#include <iclk/align/pyramid.h>

namespace iclk::internal {

inline constexpr double kCornerDistance = 8;  ///< px between two features

/// The detector of the tracker (others use detect_features() of iclk/session/detect.h). It chooses features of a frame with
/// known depth: in each cell of a lattice the points with the most texture, round by round, until there are `count`. If too few
/// corners have depth, other pixels with depth and a gradient follow.
///
/// `grey` is level 0; `border` px at the image border stay free. `depth`: r32f of the same size, 0 or NaN: unknown. `mask`: r8
/// of the same size, or empty; no patch covers pixels that are 0.
Features detect_corners(const Map& grey, const ImageView& depth, const ImageView& mask, int count, int border);

/// Chooses `count` textured points without known depth in the same way, away from the points in `taken`. `depth` may be empty.
std::vector<Eigen::Vector2d> detect_seeds(const Map& grey, const ImageView& depth, const ImageView& mask,
                                          const std::vector<Eigen::Vector2d>& taken, int count, int border);

/// The usable ones of given features, at most `count`, chosen in the same way: inside the image, in front of the camera, and
/// no pixel of their patch masked. Throws what check_features() throws.
Features choose_features(const Map& grey, const Features& given, const ImageView& mask, const Camera& camera, int count);

/// The depth of a pixel; 0: unknown.
double depth_at(const ImageView& depth, int u, int v);

}  // namespace iclk::internal
