#pragma once
#include <optional>
#include <span>

#include <iclk/track/internal/keyframes.h>

namespace iclk::internal {

/// A pose of a frame from its alignment with a keyframe.
struct Found {
  int keyframe = 0;
  RefinedAlignment alignment;
  bool confirmed = true;
};

/// Decides which alignments are accepted, and which frames become keyframes.
struct Judge {
  Camera camera;
  int min_inliers;     ///< TrackerOptions
  double min_visible;  ///< TrackerOptions

  /// Whether the features confirm the pose.
  bool confirmed(const RefinedAlignment& a) const { return a.converged() && a.refined && a.inliers >= min_inliers; }
  /// Whether a pose is acceptable that the features do not confirm, as in a blurred frame. The images must correlate at it, and
  /// it must not move a corner of the image far from its expected position.
  bool credible(const RefinedAlignment& a, const Keyframe& k, const SE3& expected) const;
  /// The same, wherever it moves the corners, if an alignment from another start has the same result.
  bool credible(const RefinedAlignment& a, const RefinedAlignment& from_elsewhere, const Keyframe& k) const;
  /// Whether two alignments with keyframe `k`, T_10, have the same result.
  bool agree(const SE3& a, const SE3& b, const Keyframe& k) const;
  /// The distance between two such results: the largest motion of an image corner, as a share of the image's width.
  double distance(const SE3& a, const SE3& b, const Keyframe& k) const;
  /// Whether a frame becomes a keyframe that was aligned with keyframe `k` at T_WC. `previous`: the previous frame.
  bool becomes_keyframe(Frame& frame, const Keyframe& k, const Found& found, const SE3& T_WC, const TrackFrame& previous) const;
  /// Of the alignments of one image with several keyframes the confirmed one with most inliers; none if another one puts the
  /// camera elsewhere in the same map, with at least half of the inliers.
  std::optional<size_t> only_place(std::span<const Keyframe* const> keyframes, std::span<const RefinedAlignment> found) const;

 private:
  double motion_from(const SE3& expected, const RefinedAlignment& a, const Keyframe& k) const;
};

}  // namespace iclk::internal
