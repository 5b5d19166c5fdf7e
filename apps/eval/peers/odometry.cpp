#include "apps/eval/peers/odometry.h"

#include <memory>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include <iclk/align/common/stopwatch.h>
#include <iclk/session/detect.h>

#include "apps/eval/peers/methods.h"
#include "apps/iclk/common/median.h"
#include "apps/iclk/common/progress.h"
#include "apps/iclk/session/pair_input.h"
#include "apps/iclk/track/run.h"

namespace iclk {
namespace {

constexpr int kFeatures = 200;

/// A frame as the methods take it.
struct PeerFrame {
  cv::Mat image, grey, depth, seen;
};

PeerFrame peer_frame(const RecordedFrames::Pixels& pixels) {
  PeerFrame out{pixels.image.clone(), grey_8bit(pixels.image), {}, pixels.mask.clone()};
  out.depth = pixels.depth.empty() ? cv::Mat(pixels.image.size(), CV_32FC1, cv::Scalar(0)) : pixels.depth.clone();
  return out;
}

PeerPair pair_of(const PeerFrame& from, const PeerFrame& to, const Camera& camera) {
  PeerPair pair;
  pair.image_0 = from.image;
  pair.image_1 = to.image;
  pair.grey_0 = from.grey;
  pair.grey_1 = to.grey;
  pair.depth_0 = with_nan(from.depth);
  pair.depth_1 = with_nan(to.depth);
  pair.camera = camera;
  DetectorOptions detector;
  detector.count = kFeatures;
  pair.features = detect_features(view(from.image), view(from.depth), view(from.seen), detector);
  return pair;
}

/// A method on its way.
struct Chain {
  std::unique_ptr<PeerMethod> method;
  SE3 T_WC;
  int failed = 0;
  std::vector<double> ms;
  std::vector<PosePair> poses;
};

}  // namespace

std::string odometry_table(RecordedFrames& frames) {
  const Progress progress = terminal_progress();
  std::vector<Chain> chains;
  for (auto make : {+[] { return make_rgbd_odometry(); }, +[] { return make_klt_pnp(); }, +[] { return make_sift_pnp(); }})
    chains.emplace_back().method = make();
  PeerFrame before;
  for (int i = 0; i < frames.size(); ++i) {
    const auto& pixels = frames.read(i);
    if (pixels.image.empty() || !frames.truth(i)) continue;
    PeerFrame frame = peer_frame(pixels);
    if (!before.image.empty()) {
      const PeerPair pair = pair_of(before, frame, frames.camera());
      for (Chain& chain : chains) {
        const internal::Stopwatch watch;
        const PeerAnswer answer = chain.method->run(pair);
        chain.ms.push_back(watch.ms());
        if (answer.has_pose && answer.claimed)
          chain.T_WC = chain.T_WC * answer.T_10.inverse();
        else
          ++chain.failed;
        chain.T_WC.orthonormalize();
      }
    }
    for (Chain& chain : chains) chain.poses.push_back({chain.T_WC, *frames.truth(i)});
    before = std::move(frame);
    progress("peers", i + 1, frames.size());
  }
  std::string text = "\nother methods, each from frame to frame:\n";
  for (const Chain& chain : chains)
    text += fmt::format("{:<14} {}; {:.0f} ms per pair, {} pairs without a pose\n", chain.method->name(),
                        to_text(track_errors(chain.poses)), median(chain.ms), chain.failed);
  return text;
}

}  // namespace iclk
