#pragma once
#include <iclk/depth/depth_sweep.h>

namespace iclk::internal {

/// Sets status and reason from what else the map holds, without sparse depths.
void judge(DepthMap& map);

}  // namespace iclk::internal
