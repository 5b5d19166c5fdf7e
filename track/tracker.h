#pragma once
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/refine/rolling_shutter.h>
#include <iclk/session/depth_sigma.h>
#include <iclk/session/session.h>

namespace iclk {

/// Pointers are read during the call only.
struct TrackFrame {
  double time = 0;  ///< s; later than the frame before
  ImageView image;
  ImageView depth;  ///< r32f, along the optical axis, in the unit of the map; 0 or NaN where there is none. May be empty
  ImageView mask;   ///< r8, 0 where the image is not to be looked at. May be empty; needs TrackerOptions::masks
};

enum class TrackStatus {
  tracked,
  keyframe,  ///< tracked, and others will be aligned with it
  lost,      ///< no pose
};
const char* name(TrackStatus status);

struct TrackerOptions {
  int features = 200;                                         ///< of a keyframe, at most
  int border = 16;                                            ///< px about an image that stay free of them
  DepthSigma depth_sigma{.constant = kStructuredLightSigma};  ///< above 0: without a sigma depths would hold nothing
  bool masks = false;                                         ///< frames come with masks
  int keyframes = 32;                                         ///< held at most, each in a slot of the aligner
  /// Places without depth in a keyframe that the sensor gives less than `features`, at most: they become features when the
  /// frames that follow have told their depth. With 0 a frame without depth becomes no keyframe.
  int seeds = 200;
  int window = 8;            ///< keyframes that a new one is aligned with, and the newest that are adjusted together
  double min_visible = 0.7;  ///< of a keyframe's features: a frame that sees fewer becomes a keyframe
  int min_inliers = 20;      ///< a pose on which fewer features agree is not confirmed
  /// Rolling shutter: s from an image's first row to its last, negative if the last comes first; 0: all at once. Frames are
  /// unrolled by how fast the camera turns, their times are those of the middle rows.
  double readout = 0;
  /// Of frames that were resampled from what the camera read: when each pixel was seen. None: rows are the camera's.
  std::optional<RowTimes> rows;

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// Where a frame was.
struct TrackResult {
  double time = 0;
  TrackStatus status = TrackStatus::lost;
  bool confirmed = false;  ///< by the features: the pose is the refinement's. Else it is the alignment's alone, and weaker
  std::string reason;      ///< the alignment's, or why there is none
  int map = 0;             ///< poses of different maps have nothing to do with each other
  int keyframe = 0;        ///< it was aligned with; of a keyframe, itself
  SE3 T_CK;                ///< camera of that keyframe to this one's: stays, while the keyframe's pose may still be adjusted
  SE3 T_WC;                ///< this camera to the map, as it is known now; of a lost frame, the last one that was known
  Matrix6d covariance = Matrix6d::Zero();  ///< of T_CK, [rho, phi]; zero if lost, and of a keyframe, whose T_CK is exact
  /// Of a keyframe: the other one that it was aligned with, and how.
  struct Origin {
    int keyframe = 0;
    SE3 T_CK;  ///< of that one's camera to this one's
    bool confirmed = true;
    Matrix6d covariance = Matrix6d::Identity();
  };
  std::optional<Origin> origin;                ///< none for the first of a map
  int features = 0, visible = 0, inliers = 0;  ///< of that alignment
  double sigma = 0;                            ///< px, of its residuals
  /// The frame that was tracked last became a keyframe after all, since nothing older was found in this one.
  struct Before {
    int keyframe = 0;
    double time = 0;
  };
  std::optional<Before> before;
  bool searched = false;  ///< what was expected did not hold, and more was tried
  double align_ms = 0, keyframe_ms = 0, bundle_ms = 0;
};

/// A feature of a keyframe that is held.
struct MapPoint {
  int keyframe = 0;
  Eigen::Vector2d uv;  ///< in the keyframe
  Eigen::Vector3d X;   ///< in the map, as it is known now
  double grey = 0;     ///< of its pixel, [0, 1]
};

/// What the features say of TrackerOptions::readout.
struct Readout {
  double seconds = 0, sigma = 0;  ///< infinite sigma: too few frames turned
};

/// Visual odometry with depth, frame by frame: each frame is aligned with a keyframe, from where the motion of the frames
/// before lets it be, else with others, from elsewhere, by a search; a frame that sees too little of it becomes a keyframe. A
/// new keyframe is aligned with those about it, both ways, and the newest ones' poses and inverse depths are adjusted together
/// to all that was seen. The first frame with depth and texture is the map's origin.
///
/// A frame whose alignment does not converge is lost, never guessed; it and those that follow are looked for among the
/// keyframes, some at each frame. A map that misses the camera for longer than it had it, as one that began with a blurred
/// frame does, is given up for a new one. Memory is bounded by TrackerOptions::keyframes, but for one pose a keyframe that ever
/// was. One thread at a time.
class Tracker {
 public:
  /// What the aligner of a tracker has to be made for. Its options need a start search (AlignerOptions::search), without which
  /// nothing lost is found again. Of models the format has to be rgba8.
  static Plan plan(const Camera& camera, const TrackerOptions& options);

  /// With an aligner of the session's first model, made for plan(). The session need not outlive the tracker. Throws
  /// Error(invalid_argument) for bad options, and what Session::make_aligner() throws.
  Tracker(const Session& session, const Camera& camera, const TrackerOptions& options = {});
  /// `aligner` must outlive the tracker, and nobody else use its slots. Throws Error(invalid_argument) for bad options and an
  /// aligner of a smaller plan.
  Tracker(Aligner& aligner, const Camera& camera, const TrackerOptions& options = {});
  ~Tracker();

  /// Throws Error(invalid_argument) for an image, depth or mask of another size or format, and a time that is not finite or
  /// not later than the last; what Aligner throws.
  TrackResult track(const TrackFrame& frame);

  int keyframe_count() const;              ///< that ever were
  const SE3& keyframe_pose(int id) const;  ///< T_WC, as it is known now
  std::vector<MapPoint> map() const;       ///< keyframe by keyframe, the oldest first
  /// All that is known, some 0.5 MB a keyframe at 640x480; a tracker of the same aligner settings, camera and options goes on
  /// from it as this one would, to the bit. restore() throws Error(invalid_argument) for what state() did not return, and
  /// leaves the tracker as it was.
  std::vector<uint8_t> state() const;
  void restore(std::span<const uint8_t> state);
  Readout readout() const;

  struct Impl;                                      ///< internal/tracker_impl.h
  const Impl& internals() const { return *impl_; }  ///< for tests

 private:
  std::unique_ptr<Aligner> own_;  // of a session; else null
  std::unique_ptr<Impl> impl_;
};

}  // namespace iclk
