#pragma once
#include <span>
#include <vector>

#include <iclk/track/internal/window.h>

namespace iclk::internal {

/// Adds features without sensor depth: features of other keyframes, and seeds, whose depths are estimated from later frames.
class Seeder {
 public:
  Seeder(const Camera& camera, const TrackerOptions& options, const Judge& judge)
      : camera_(camera), options_(options), judge_(judge) {}

  /// Whether a frame with this number of features with sensor depth needs more.
  bool helps(int measured) const { return options_.seeds > 0 && measured < options_.features; }
  /// Adds features of neighbours that were found in the frame, where it has no depth and no feature yet. Some of the number
  /// stays free for new features.
  void carry(const TrackFrame& frame, std::span<const Neighbour> neighbours, Features& to) const;
  /// Chooses the seeds of a new keyframe.
  void sow(Keyframe& k, Frame& frame) const;
  /// Searches for its seeds in the most similar neighbours. Returns whether some became features.
  bool look_back(Keyframe& k, Frame& frame, std::span<const Neighbour> neighbours);
  /// Searches for the seeds of a keyframe in a frame that was aligned with it. Returns whether some became features.
  bool look(Keyframe& k, Frame& frame, const RefinedAlignment& a);

 private:
  void sight(Keyframe& k, const Pyramid& f1, const SE3& T_10, const Matrix6d& covariance) const;
  void look_for(Keyframe::Seed& seed, const Pyramid& f1, const SE3& T_10, const Matrix6d& covariance) const;
  bool harvest(Keyframe& k, int least) const;

  Camera camera_;
  const TrackerOptions& options_;
  const Judge& judge_;
  int looked_at_ = -1;  // the keyframe of `looked_`, which is kept from frame to frame
  Pyramid looked_;
};

}  // namespace iclk::internal
