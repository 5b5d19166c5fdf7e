#pragma once
#include <optional>
#include <span>
#include <vector>

#include <iclk/track/internal/judge.h>
#include <iclk/track/internal/motion.h>
#include <iclk/track/internal/reach.h>

namespace iclk::internal {

/// The expected pose of a frame, and the best pose so far that is credible but not confirmed.
struct Search {
  SE3 expected;
  std::optional<Found> weak = {};
};

/// Finds the pose of a frame among the keyframes. Each method from follow() to relocalise() searches more widely.
class Locator {
 public:
  /// `batch`: the largest number of pairs that are aligned at once. `unbending`: for try_current().
  Locator(const Camera& camera, const Judge& judge, Refiner& refiner, Refiner& unbending, Keyframes& keyframes,
          const Reach& reach, int batch)
      : camera_(camera),
        judge_(judge),
        refiner_(refiner),
        unbending_(unbending),
        keyframes_(keyframes),
        reach_(reach),
        batch_(static_cast<size_t>(batch)) {}

  /// Aligns with the keyframe of the last frame, or with one that shows much more.
  std::optional<Found> follow(const TrackFrame& frame, Search& search);
  /// Aligns with other keyframes. If no pose is credible yet, also with the current one, from the last pose and by a search.
  std::optional<Found> try_others(const TrackFrame& frame, const Motion& motion, Search& search);
  /// The credible pose, if more than a share `visible` of its keyframe's features is visible at the expected pose.
  std::optional<Found> credible(const Search& search, double visible);
  /// Aligns with the current keyframe, from the expected pose and from the last pose, with what is left of a rolling shutter
  /// corrected. Features that prove a turn confirm poses that they would else not confirm.
  std::optional<Found> try_current(const TrackFrame& frame, const Motion& motion, Search& search);
  /// Searches with one batch of keyframes: those near the last pose, and those of all maps, held or archived, that look most
  /// like the frame. Places out of reach do not count. The keyframe that is found is held afterwards.
  std::optional<Found> relocalise(Frame& frame, const SE3& last);

  struct State {
    int current = 0;  ///< the keyframe with which the last frame was aligned
  } state;

 private:
  /// Keeps the pose in `search` if it is credible and has more inliers than the one there.
  void consider(int id, const RefinedAlignment& a, Search& search);
  std::optional<Found> best_of(std::span<const int> ids, std::span<RefinedAlignment> found);
  std::vector<int> lost_among(const Signature& signature, const SE3& last);

  Camera camera_;
  const Judge& judge_;
  Refiner &refiner_, &unbending_;
  Keyframes& keyframes_;
  const Reach& reach_;
  size_t batch_;
};

}  // namespace iclk::internal
