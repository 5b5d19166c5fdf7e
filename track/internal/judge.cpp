#include <iclk/track/internal/judge.h>

#include <algorithm>
#include <cmath>
#include <numeric>

namespace iclk::internal {
namespace {

constexpr double kCorrelation = 0.75;  ///< of the images, at a pose that is credible
constexpr double kMotion = 0.06;       ///< of the image's width

/// So little is left of a keyframe that a frame must become one, blurred or not.
constexpr double kLittleVisible = 0.5;
/// Of the image's width: a frame in which features moved farther becomes one.
constexpr double kMostFlow = 0.15;
/// A frame without depth becomes a keyframe if features moved so much, as a share of the image's width, and if so few inliers,
/// times min_inliers or of those visible, are left.
constexpr double kSomeFlow = 0.03, kFewOfVisible = 0.5;
constexpr int kFewInliers = 3;
/// Frames with depth may be rare: one takes over from a keyframe that lacks it when features moved so much.
constexpr double kLittleFlow = 0.01;
/// A camera that went so far that the keyframe's depths are wrong by so many px shows it: features are found, but do not agree.
/// Below a half of them would confirm no pose.
constexpr double kCoarse = 1, kFewOfFound = 0.6;
/// A frame whose gradients have less of the keyframe's energy is blurred, and becomes none unless it has to.
constexpr double kSharp = 0.7;
/// Other places have less texture: where features dwindle, a frame without depth may be less sharp than its keyframe, but not
/// than the frame before.
constexpr double kAsSharp = 0.9;
/// A frame that is so much sharper than its keyframe is the better one.
constexpr double kMuchSharper = 1.3;

/// The features that are found in a frame do not agree, since the keyframe's depths are too coarse for how far it is.
bool disagree(const Camera& camera, const Keyframe& k, const RefinedAlignment& a) {
  const auto found =
      std::count_if(a.features.begin(), a.features.end(), [](const auto& f) { return f.status == FeatureStatus::aligned; });
  const double sum = std::accumulate(k.sigma.begin(), k.sigma.end(), 0.0), count = static_cast<double>(k.sigma.size());
  return std::abs(camera.fx) * a.T_10.t.norm() * sum > kCoarse * count && a.inliers < kFewOfFound * static_cast<double>(found);
}

/// The keyframe's features are worth less than new ones. A sensor's depths are better than those by motion; without them
/// features can only be carried over while they are found.
bool worn(const Camera& camera, int min_inliers, bool depth, const Keyframe& k, const RefinedAlignment& a, double flow) {
  const bool moved = flow > kSomeFlow * camera.width;
  if (!depth) return moved && (a.inliers < kFewInliers * min_inliers || a.inliers < kFewOfVisible * a.visible);
  return (moved && disagree(camera, k, a)) || (!k.with_depth && flow > kLittleFlow * camera.width);
}

}  // namespace

bool Judge::credible(const RefinedAlignment& a, const Keyframe& k, const SE3& expected) const {
  if (!a.converged() || a.refined || a.iclk.correlation < kCorrelation) return false;
  // How far what the frame shows in its corners moved from where it was expected, at the keyframe's mean depth.
  const SE3 off = expected.inverse() * (k.T_WC * a.T_10.inverse());
  const double z = 1 / mean_inverse_depth(k), w = camera.width - 1, h = camera.height - 1;
  for (const Eigen::Vector2d& uv :
       {Eigen::Vector2d(0, 0), Eigen::Vector2d(w, 0), Eigen::Vector2d(0, h), Eigen::Vector2d(w, h)}) {
    const Eigen::Vector3d X = off * (camera.ray(uv) * z);
    if (!(X.z() > 0) || (camera.project(X) - uv).norm() > kMotion * camera.width) return false;
  }
  return true;
}

bool Judge::becomes_keyframe(Frame& frame, const Keyframe& k, const Found& found, const SE3& T_WC,
                             const TrackFrame& previous) const {
  const Overlap seen = overlap(camera, k, T_WC);
  if (seen.visible < kLittleVisible) return true;
  const bool depth = !frame.seen().depth.empty();
  const bool renew = worn(camera, min_inliers, depth, k, found.alignment, seen.flow);
  if (!renew && found.confirmed && seen.visible >= min_visible && seen.flow <= kMostFlow * camera.width) return false;
  const double ratio = frame.sharpness() / k.sharpness;
  if (ratio > (found.confirmed ? kSharp : kMuchSharper)) return true;
  return found.confirmed && !depth && renew && frame.sharpness() > kAsSharp * Frame(previous).sharpness();
}

}  // namespace iclk::internal
