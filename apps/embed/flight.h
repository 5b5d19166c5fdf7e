#pragma once
#include <vector>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/align/se3.h>

#include "apps/render/terrain.h"

namespace embed {

/// Where the camera is in frame `frame`, T_WC: on a circle about the middle of the map, 4 m a frame, looking down and swaying.
iclk::SE3 camera_pose(const iclk::Terrain& terrain, int frame);

/// A point of the ground, in map coordinates.
struct Landmark {
  Eigen::Vector3d X;
  double roughness = 0;  ///< m by which the ground around it, up to 3 m away, bends away from it
};

/// Points on a lattice of `spacing` metres. They are what makes features without reading a rendered depth back: the host knows
/// the terrain. Hollows, which something near could hide, are left out.
std::vector<Landmark> landmarks(const iclk::Terrain& terrain, double spacing);

/// Of the landmarks that camera T_WC sees, at most `count`, spread over the image: the least rough of each part of it, because
/// one depth holds for a patch. 17 px from the border, where 8x8 patches fit on the coarser levels. Occlusion is not tested:
/// from above it is rare.
iclk::Features visible_features(const std::vector<Landmark>& landmarks, const iclk::Camera& camera, const iclk::SE3& T_WC,
                                int count);

}  // namespace embed
