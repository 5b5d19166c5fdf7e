#pragma once
#include <iclk/depth/depth_sweep.h>

namespace iclk::internal {

/// Sets status and reason from the other fields of the map, without sparse depths.
void judge(DepthMap& map);

}  // namespace iclk::internal
