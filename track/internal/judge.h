#pragma once
#include <iclk/track/internal/keyframes.h>

namespace iclk::internal {

/// A pose of a frame, by its alignment with a keyframe.
struct Found {
  int keyframe = 0;
  RefinedAlignment alignment;
  bool confirmed = true;
};

/// Says which alignments are believed, and which frames become keyframes.
struct Judge {
  Camera camera;
  int min_inliers;     ///< TrackerOptions
  double min_visible;  ///< TrackerOptions

  /// By the features.
  bool confirmed(const RefinedAlignment& a) const { return a.converged() && a.refined && a.inliers >= min_inliers; }
  /// A pose that the features do not confirm, as in a blurred frame: the images correlate at it, and it moves no corner of the
  /// image far from where it was expected.
  bool credible(const RefinedAlignment& a, const Keyframe& k, const SE3& expected) const;
  /// A frame that was found at T_WC by keyframe `k`. `previous`: the frame before.
  bool becomes_keyframe(Frame& frame, const Keyframe& k, const Found& found, const SE3& T_WC, const TrackFrame& previous) const;
};

}  // namespace iclk::internal
