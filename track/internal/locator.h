#pragma once
#include <optional>
#include <span>
#include <vector>

#include <iclk/track/internal/judge.h>
#include <iclk/track/internal/motion.h>

namespace iclk::internal {

/// Where a frame is expected, and the better one of the poses there that are only credible.
struct Search {
  SE3 expected;
  std::optional<Found> weak = {};
};

/// Finds a frame's pose among the keyframes: from follow() to relocalise() each looks farther.
class Locator {
 public:
  /// `batch`: pairs that are aligned at once, at most.
  Locator(const Camera& camera, const Judge& judge, Refiner& refiner, Keyframes& keyframes, int batch)
      : camera_(camera), judge_(judge), refiner_(refiner), keyframes_(keyframes), batch_(static_cast<size_t>(batch)) {}

  /// By the keyframe of the last frame, or the one that shows much more.
  std::optional<Found> follow(const TrackFrame& frame, Search& search);
  /// By others; and where nothing is credible, from no motion and by matching.
  std::optional<Found> try_others(const TrackFrame& frame, const Motion& motion, Search& search);
  /// What is credible, if its keyframe shows so much of what is expected.
  std::optional<Found> credible(const Search& search, double visible);
  /// By the current keyframe, from where the frame is expected and from where the last one was.
  std::optional<Found> try_current(const TrackFrame& frame, const Motion& motion, Search& search);
  /// Among as many keyframes as a batch holds, so that a frame does not take for ever: those about the last pose, and others
  /// in turn.
  std::optional<Found> relocalise(const TrackFrame& frame, const SE3& last);

  struct State {
    int current = 0;     ///< keyframe that the last frame was aligned with
    int next_tried = 0;  ///< where relocalise() goes on among the keyframes
  } state;

 private:
  /// Keeps what is credible, if it is the better one.
  void consider(int id, const RefinedAlignment& a, Search& search);
  std::optional<Found> best_of(std::span<const int> ids, std::span<RefinedAlignment> found);
  std::vector<int> lost_among(const SE3& last);

  Camera camera_;
  const Judge& judge_;
  Refiner& refiner_;
  Keyframes& keyframes_;
  size_t batch_;
};

}  // namespace iclk::internal
