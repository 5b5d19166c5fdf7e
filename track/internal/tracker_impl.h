#pragma once
#include <optional>
#include <vector>

#include <iclk/track/internal/locator.h>
#include <iclk/track/internal/seeder.h>
#include <iclk/track/internal/unroller.h>
#include <iclk/track/internal/window.h>

namespace iclk {

/// A frame's way through the workers. Each has its own state; they share the keyframes.
struct Tracker::Impl {
  using Frame = internal::Frame;
  using Found = internal::Found;

  Impl(Aligner& aligner, const Camera& camera, const TrackerOptions& options);

  TrackResult track(const TrackFrame& given);
  void check(const TrackFrame& given) const;
  /// A map, with the frame as its origin.
  TrackResult begin(Frame& frame, TrackResult result);
  /// Sets `searched` and `before` of the result.
  std::optional<Found> locate(Frame& frame, TrackResult& result);
  /// Makes a keyframe of the frame before.
  bool make_previous_keyframe(TrackResult& result);
  TrackResult lose(Frame& frame, TrackResult result);
  /// `found`: the frame's alignment with a keyframe, if there is one. False if it has too few features.
  bool make_keyframe(Frame& frame, const SE3& T_WC, const std::optional<TrackResult::Origin>& origin, const Found* found,
                     TrackResult& result);
  void fill(internal::Keyframe& k, Frame& frame, Features features, int measured);
  const Features& measure(Frame& frame) const;
  int least_features() const { return 2 * options.min_inliers; }
  void look_for_seeds(internal::Keyframe& k, Frame& frame, const RefinedAlignment& a, TrackResult& result);
  /// The frame has a pose. `pixels`: of it, if it has to become a keyframe after all; unrolled with `rate`.
  void keep(const TrackFrame& pixels, const Eigen::Vector3d& rate, const std::optional<TrackResult::Origin>& origin,
            const SE3& T_WC);

  Aligner& aligner;
  Camera camera;
  TrackerOptions options;
  internal::Judge judge;
  Refiner refiner;
  internal::Keyframes keyframes;
  internal::Unroller unroller;
  internal::Locator locator;
  internal::Window window;
  internal::Seeder seeder;
  internal::Motion motion;
  /// The last frame with a pose.
  struct Previous {
    internal::FramePixels pixels;
    Eigen::Vector3d rate = Eigen::Vector3d::Zero();
    std::optional<TrackResult::Origin> origin;
  } previous;
  int map = 0;
  int64_t frames_tracked = 0, frames_lost = 0;  ///< of this map: in all; since it had the camera last
  std::optional<double> last_time;              ///< of any frame
};

}  // namespace iclk
