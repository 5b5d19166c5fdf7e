#pragma once
#include <optional>
#include <vector>

#include <iclk/track/internal/learned_locator.h>
#include <iclk/track/internal/locator.h>
#include <iclk/track/internal/loops.h>
#include <iclk/track/internal/place_finder.h>
#include <iclk/track/internal/seeder.h>
#include <iclk/track/internal/unroller.h>
#include <iclk/track/internal/window.h>

namespace iclk {

/// Passes frames through the workers. Each worker has its own state; they share the keyframes.
struct Tracker::Impl {
  using Frame = internal::Frame;
  using Found = internal::Found;

  Impl(Aligner& aligner, const Camera& camera, const TrackerOptions& options);

  TrackResult track(const TrackFrame& given);
  void check(const TrackFrame& given) const;
  /// Begins a map with the frame as its origin.
  TrackResult begin(Frame& frame, TrackResult result);
  /// Finds the pose of the frame. Sets `searched` and `before` of the result.
  std::optional<Found> locate(Frame& frame, TrackResult& result);
  /// Makes a keyframe of the previous frame.
  bool make_previous_keyframe(TrackResult& result);
  /// Aligns with the last frame that has no pose. If that succeeds, that frame is the first keyframe of a new map.
  std::optional<Found> follow_unplaced(const TrackFrame& frame, TrackResult& result);
  std::optional<RefinedAlignment> align_with_unplaced(const TrackFrame& frame, const Reference& unplaced_frame);
  /// Aligns with the current keyframe by the learned models.
  std::optional<Found> align_learned(const TrackFrame& frame, const SE3& expected);
  TrackResult lose(Frame& frame, TrackResult result);
  /// Finds an earlier visit of the new keyframe's place: closes a loop, or joins two maps.
  void recognise(internal::Keyframe& k, TrackResult& result);
  void link_place(internal::Keyframe& k, internal::Link& link, TrackResult& result);
  void join_maps(internal::Keyframe& k, const internal::BundleEdge& link);
  /// Makes a keyframe of the frame. `found`: its alignment with another keyframe, or null. Returns false if it has too few
  /// features.
  bool make_keyframe(Frame& frame, const SE3& T_WC, const std::optional<TrackResult::Origin>& origin, const Found* found,
                     TrackResult& result);
  void fill(internal::Keyframe& k, Frame& frame, Features features, int measured);
  const Features& measure(Frame& frame) const;
  int least_features() const { return 2 * options.min_inliers; }
  void look_for_seeds(internal::Keyframe& k, Frame& frame, const RefinedAlignment& a, TrackResult& result);
  /// Keeps a frame with a pose. `pixels`: its images, corrected with `rate`, in case it becomes a keyframe later.
  void keep(const TrackFrame& pixels, const Eigen::Vector3d& rate, const std::optional<TrackResult::Origin>& origin,
            const SE3& T_WC);

  /// The distance of a pose from the current keyframe.
  double from_keyframe(const SE3& T_WC) const;

  Aligner& aligner;
  Camera camera;
  TrackerOptions options;
  internal::Judge judge;
  Refiner refiner, unbending;
  internal::Keyframes keyframes;
  internal::Reach reach;
  internal::Unroller unroller;
  internal::Locator locator;
  internal::PlaceFinder places;
  internal::Loops loops;
  std::optional<internal::LearnedLocator> learned;
  internal::Window window;
  internal::Seeder seeder;
  internal::Motion motion;
  /// The last frame with a pose.
  struct Previous {
    internal::FramePixels pixels;
    Eigen::Vector3d rate = Eigen::Vector3d::Zero();
    std::optional<TrackResult::Origin> origin;
  } previous;
  std::optional<internal::FramePixels> unplaced;  ///< the last lost frame from which a map can begin
  double way = 0;                                 ///< length, of the frames with a pose
  int maps = 1;                                   ///< ever begun
  int64_t frames_tracked = 0, frames_lost = 0;    ///< since the current map was begun; since the last frame with a pose
  std::optional<double> last_time;                ///< of any frame
};

}  // namespace iclk
