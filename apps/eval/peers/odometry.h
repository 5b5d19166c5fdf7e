#pragma once
#include <string>

#include "apps/iclk/track/frames.h"

namespace iclk {

/// Odometry by the methods of apps/eval/peers/methods.h that need no more than two frames, from each frame to the next, each
/// with its usual settings, over the frames that can be read and have a truth. Lines of text: errors, the median of a pair's
/// time (images in memory, features given), and pairs without a claim, where the camera is taken to have stood still. Shows
/// its progress.
std::string odometry_table(RecordedFrames& frames);

}  // namespace iclk
