#pragma once
#include <span>
#include <vector>

#include <iclk/track/internal/window.h>

namespace iclk::internal {

/// Features where no depth is known: carried over from other keyframes, and seeds, whose depths the following frames tell.
class Seeder {
 public:
  Seeder(const Camera& camera, const TrackerOptions& options, const Judge& judge)
      : camera_(camera), options_(options), judge_(judge) {}

  /// A frame for which the sensor has so few features gets help.
  bool helps(int measured) const { return options_.seeds > 0 && measured < options_.features; }
  /// Adds features of the neighbours that were found in the frame, where it has no depth and no feature yet; places for what
  /// is new are left.
  void carry(const TrackFrame& frame, std::span<const Neighbour> neighbours, Features& to) const;
  /// Seeds of a new keyframe.
  void sow(Keyframe& k, Frame& frame) const;
  /// Looks for its seeds in the neighbours that are most alike. Whether some became features.
  bool look_back(Keyframe& k, Frame& frame, std::span<const Neighbour> neighbours);
  /// Looks for the seeds of a keyframe in a frame, aligned with it. Whether some became features.
  bool look(Keyframe& k, Frame& frame, const RefinedAlignment& a);

 private:
  void sight(Keyframe& k, const Pyramid& f1, const SE3& T_10, const Matrix6d& covariance) const;
  void look_for(Keyframe::Seed& seed, const Pyramid& f1, const SE3& T_10, const Matrix6d& covariance) const;
  bool harvest(Keyframe& k, int least) const;

  Camera camera_;
  const TrackerOptions& options_;
  const Judge& judge_;
  int looked_at_ = -1;  // keyframe whose pyramid this is: kept from frame to frame
  Pyramid looked_;
};

}  // namespace iclk::internal
