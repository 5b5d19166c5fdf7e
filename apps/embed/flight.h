#pragma once
#include <iclk/align/se3.h>
#include <iclk/render/terrain.h>

namespace embed {

/// Where the camera is in frame `frame`, T_WC: on a circle about the middle of the map, 4 m a frame, looking down and swaying.
iclk::SE3 camera_pose(const iclk::Terrain& terrain, int frame);

}  // namespace embed
