#include <iclk/track/internal/judge.h>

#include <algorithm>
#include <cmath>
#include <numeric>

namespace iclk::internal {
namespace {

constexpr double kCorrelation = 0.75;  ///< of the images, at a credible pose
constexpr double kMotion = 0.06;       ///< of the image's width
constexpr double kElsewhere = 0.15;    ///< of the image's width: more than the drift between two visits of a place
constexpr double kAgree = 0.01;        ///< of the image's width: the largest motion of a corner between two poses that agree

/// With a smaller visible share of its keyframe, a frame must become one, even if it is blurred.
constexpr double kLittleVisible = 0.5;
/// A frame in which features moved farther becomes a keyframe; share of the image's width.
constexpr double kMostFlow = 0.15;
/// A frame without depth becomes a keyframe if features moved by this share of the image's width and few inliers are left: as a
/// factor of min_inliers or a share of the visible features.
constexpr double kSomeFlow = 0.03, kFewOfVisible = 0.5;
constexpr int kFewInliers = 3;
/// Frames with depth may be rare: one replaces a keyframe without depth when features moved this far.
constexpr double kLittleFlow = 0.01;
/// If the camera moved so far that the keyframe's depth errors reach this many px, features are found but do not agree. Less
/// than half of them would confirm no pose.
constexpr double kCoarse = 1, kFewOfFound = 0.6;
/// A frame whose gradients have a smaller share of the keyframe's energy is blurred. It becomes a keyframe only if it must.
constexpr double kSharp = 0.7;
/// Other places have less texture. If features become few, a frame without depth may be less sharp than its keyframe, but not
/// less sharp than the previous frame.
constexpr double kAsSharp = 0.9;
/// A frame that is sharper than its keyframe by this factor replaces it.
constexpr double kMuchSharper = 1.3;

/// Whether the features of a frame do not agree because the keyframe's depths are too inaccurate for its distance.
bool disagree(const Camera& camera, const Keyframe& k, const RefinedAlignment& a) {
  const auto found =
      std::count_if(a.features.begin(), a.features.end(), [](const auto& f) { return f.status == FeatureStatus::aligned; });
  const double sum = std::accumulate(k.sigma.begin(), k.sigma.end(), 0.0), count = static_cast<double>(k.sigma.size());
  return std::abs(camera.fx) * a.T_10.t.norm() * sum > kCoarse * count && a.inliers < kFewOfFound * static_cast<double>(found);
}

/// Whether the keyframe's features are worse than new ones. Depths of a sensor are better than depths by motion. Without a
/// sensor, features can be carried over only while they are found.
bool worn(const Camera& camera, int min_inliers, bool depth, const Keyframe& k, const RefinedAlignment& a, double flow) {
  const bool moved = flow > kSomeFlow * camera.width;
  if (!depth) return moved && (a.inliers < kFewInliers * min_inliers || a.inliers < kFewOfVisible * a.visible);
  return (moved && disagree(camera, k, a)) || (!k.with_depth && flow > kLittleFlow * camera.width);
}

}  // namespace

bool Judge::credible(const RefinedAlignment& a, const Keyframe& k, const SE3& expected) const {
  if (!a.converged() || a.refined || a.iclk.correlation < kCorrelation) return false;
  return motion_from(expected, a, k) <= kMotion * camera.width;
}

bool Judge::credible(const RefinedAlignment& a, const RefinedAlignment& from_elsewhere, const Keyframe& k) const {
  for (const RefinedAlignment* each : {&a, &from_elsewhere})
    if (!each->converged() || each->inliers < min_inliers || each->iclk.correlation < kCorrelation) return false;
  return agree(a.T_10, from_elsewhere.T_10, k);
}

std::optional<size_t> Judge::only_place(std::span<const Keyframe* const> keyframes,
                                        std::span<const RefinedAlignment> found) const {
  std::optional<size_t> best;
  for (size_t i = 0; i < found.size(); ++i)
    if (confirmed(found[i]) && (!best || found[i].inliers > found[*best].inliers)) best = i;
  if (!best) return {};
  const SE3 T_WC = keyframes[*best]->T_WC * found[*best].T_10.inverse();
  for (size_t i = 0; i < found.size(); ++i) {
    const Keyframe& k = *keyframes[i];
    if (k.map != keyframes[*best]->map || !confirmed(found[i]) || 2 * found[i].inliers < found[*best].inliers) continue;
    if (motion_from(T_WC, found[i], k) > kElsewhere * camera.width) return {};
  }
  return best;
}

double Judge::motion_from(const SE3& expected, const RefinedAlignment& a, const Keyframe& k) const {
  return corner_motion(camera, expected.inverse() * (k.T_WC * a.T_10.inverse()), 1 / mean_inverse_depth(k));
}

double Judge::distance(const SE3& a, const SE3& b, const Keyframe& k) const {
  return corner_motion(camera, a * b.inverse(), 1 / mean_inverse_depth(k)) / camera.width;
}

bool Judge::agree(const SE3& a, const SE3& b, const Keyframe& k) const { return distance(a, b, k) <= kAgree; }

bool Judge::becomes_keyframe(Frame& frame, const Keyframe& k, const Found& found, const SE3& T_WC,
                             const TrackFrame& previous) const {
  const Overlap seen = overlap(camera, k, T_WC);
  if (seen.visible < kLittleVisible) return true;
  const bool depth = frame.seen().has_depth();
  const bool renew = worn(camera, min_inliers, depth, k, found.alignment, seen.flow);
  if (!renew && found.confirmed && seen.visible >= min_visible && seen.flow <= kMostFlow * camera.width) return false;
  const double ratio = frame.sharpness() / k.sharpness;
  if (ratio > (found.confirmed ? kSharp : kMuchSharper)) return true;
  return found.confirmed && !depth && renew && frame.sharpness() > kAsSharp * Frame(previous).sharpness();
}

}  // namespace iclk::internal
