#pragma once
#include <functional>
#include <string>
#include <vector>

#include "apps/iclk/track/frames.h"
#include "apps/iclk/track/run.h"

namespace iclk {

/// Odometry of another method, from each frame to the next.
struct TrackPeer {
  std::string method;
  int failed = 0;  ///< pairs without a claim: the camera is taken to have stood still
  double ms = 0;   ///< median of a pair, images in memory, features given
  TrackErrors errors;
};

/// Odometry by the methods of apps/eval/peers/methods.h that need no more than two frames, each with its usual settings, over
/// the frames that can be read and have a truth. `progress`: pairs done, of how many.
std::vector<TrackPeer> chain_peers(RecordedFrames& frames, const std::function<void(int, int)>& progress);

/// The peers as lines of text.
std::string to_text(const std::vector<TrackPeer>& peers);

}  // namespace iclk
