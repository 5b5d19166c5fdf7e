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

/// A frame of a sequence. Pointers are read during the call only.
struct TrackFrame {
  double time = 0;  ///< s; later than the previous frame
  ImageView image;
  ImageView depth;  ///< r32f, along the optical axis, in the unit of the map; 0 or NaN: unknown. May be empty
  ImageView mask;   ///< r8; pixels that are 0 are ignored. May be empty; needs TrackerOptions::masks
  /// Features with known depth, used instead of corners of `depth`; or null. Those that cannot be used are left out. If there
  /// are more than TrackerOptions::features, those with the most texture are used. Unknown sigmas: TrackerOptions::depth_sigma.
  const Features* features = nullptr;

  bool has_depth() const { return !depth.empty() || (features && features->size() > 0); }
};

enum class TrackStatus {
  tracked,
  keyframe,  ///< tracked, and later frames are aligned with it
  lost,      ///< no pose
};
const char* name(TrackStatus status);

struct TrackerOptions {
  int features = 200;                                         ///< of a keyframe, at most
  int border = 16;                                            ///< px at the image border without features
  DepthSigma depth_sigma{.constant = kStructuredLightSigma};  ///< must be above 0, or depths have no weight
  bool masks = false;                                         ///< frames may have masks
  int keyframes = 32;                                         ///< at most that frames are aligned with, in slots of the aligner
  /// The largest number of older keyframes that are kept to recognise their places: for loops, joined maps and lost frames.
  /// Each takes as much memory as its image. 0: places are not recognised.
  int archive = 500;
  /// The largest number of points per keyframe whose depth is estimated from later frames. They are used if the sensor gives
  /// depth for fewer than `features` points. 0: frames without depth do not become keyframes.
  int seeds = 200;
  int window = 8;            ///< a new keyframe is aligned with so many keyframes, and so many newest are adjusted together
  double min_visible = 0.7;  ///< a frame that sees a smaller share of the keyframe's features becomes a keyframe
  int min_inliers = 20;      ///< a pose with fewer inliers is not confirmed
  /// Rolling shutter: the time from the first row of an image to its last, s; negative if the last row is read first; 0: global
  /// shutter. Frames are corrected by the turn rate of the camera; their times are those of the middle rows.
  double readout = 0;
  /// For resampled frames: the time at which each pixel was read. Empty: the rows are those of the camera.
  std::optional<RowTimes> rows;

  /// Throws Error(invalid_argument) that names the value and its range.
  void check() const;
};

/// The pose of a frame.
struct TrackResult {
  double time = 0;
  TrackStatus status = TrackStatus::lost;
  bool confirmed = false;  ///< true: the features confirm the pose, which is refined; false: a weaker pose, from ICLK alone
  std::string reason;      ///< that of the alignment, or why there is none
  int map = 0;             ///< poses of different maps are unrelated; by present knowledge: Tracker::keyframe_map()
  int keyframe = 0;        ///< the one that the frame was aligned with; for a keyframe, the frame itself
  SE3 T_CK;                ///< camera of that keyframe to this camera; it is final, but the keyframe's pose may still change
  SE3 T_WC;                ///< this camera to the map, by present knowledge; for a lost frame, the last known pose
  Matrix6d covariance = Matrix6d::Zero();  ///< of T_CK, [rho, phi]; zero if lost, and for a keyframe, whose T_CK is exact
  /// For a keyframe: its alignment with another keyframe.
  struct Origin {
    int keyframe = 0;
    SE3 T_CK;  ///< camera of that keyframe to this camera
    bool confirmed = true;
    Matrix6d covariance = Matrix6d::Identity();
  };
  std::optional<Origin> origin;                ///< empty for the first keyframe of a map
  int features = 0, visible = 0, inliers = 0;  ///< of that alignment
  double sigma = 0;                            ///< px, of its residuals
  /// An earlier frame that became a keyframe now, because this frame could not be aligned with older keyframes: the last
  /// tracked frame; or the last lost one, which begins a map.
  struct Before {
    int keyframe = 0;
    double time = 0;
  };
  std::optional<Before> before;
  bool searched = false;  ///< the predicted pose failed; other keyframes or a search were tried
  double align_ms = 0, keyframe_ms = 0, bundle_ms = 0;
};

/// A feature of a keyframe in memory.
struct MapPoint {
  int keyframe = 0;
  int map = 0;
  Eigen::Vector2d uv;  ///< px, in the keyframe
  Eigen::Vector3d X;   ///< in the map, by present knowledge
  double grey = 0;     ///< of its pixel, [0, 1]
};

/// An estimate of TrackerOptions::readout from the features.
struct Readout {
  double seconds = 0, sigma = 0;  ///< s; infinite sigma: too few frames turned
};

/// Visual odometry with depth. Each frame is aligned with a keyframe, starting from the pose that the last motion predicts. If
/// that fails, other keyframes, other starts and a search are tried. A frame that sees too little of its keyframe becomes a
/// keyframe. It is aligned with nearby keyframes, both ways; then bundle adjustment refines poses and inverse depths of the
/// newest keyframes. The first frame with depth and texture is the origin of the map.
///
/// A frame whose alignment does not converge is lost; its pose is never guessed. Each later frame is then aligned with some of
/// the keyframes, and with the frame before it. If only the latter succeeds, a new map begins with the frame before. Two maps
/// become one when a keyframe of one is found in the other. If the camera returns to a place, the loop is closed: the drift
/// since then is distributed over the keyframes of the way. TrackerOptions::keyframes and archive bound the memory, except for
/// a pose and a few motions per keyframe ever made. One thread at a time.
class Tracker {
 public:
  /// The plan that the aligner of a tracker must have. Its options need AlignerOptions::search, or the tracker cannot find lost
  /// frames. With a model, set the format to rgba8.
  static Plan plan(const Camera& camera, const TrackerOptions& options);

  /// Makes an aligner of the session's first model for plan(). The other models of the session place the frames that the first
  /// one cannot place. The session need not outlive the tracker. Throws
  /// Error(invalid_argument) for bad options, and the errors of Session::make_aligner().
  Tracker(const Session& session, const Camera& camera, const TrackerOptions& options = {});
  /// `aligner` must outlive the tracker, and only the tracker may use its slots. Throws Error(invalid_argument) for bad options
  /// and for an aligner with a smaller plan.
  Tracker(Aligner& aligner, const Camera& camera, const TrackerOptions& options = {});
  ~Tracker();

  /// Tracks the next frame. Throws Error(invalid_argument) for an image, depth or mask of a wrong size or format, for features
  /// whose vectors differ in length or whose sigma is negative or infinite, and for an invalid time: it must be finite and
  /// later than that of the last frame. Throws the errors of Aligner.
  TrackResult track(const TrackFrame& frame);

  int keyframe_count() const;              ///< of all keyframes ever made
  const SE3& keyframe_pose(int id) const;  ///< T_WC, by present knowledge
  int keyframe_map(int id) const;          ///< its map, by present knowledge
  std::vector<MapPoint> map() const;       ///< by keyframe, the oldest first
  /// The complete state, about 0.5 MB per keyframe at 640x480.
  std::vector<uint8_t> state() const;
  /// Continues from a state of a tracker with the same aligner settings, camera and options; later results are bit-identical.
  /// Throws Error(invalid_argument) for data that state() did not return, which may come from anywhere; then the tracker is
  /// unchanged.
  void restore(std::span<const uint8_t> state);
  /// Starts a recording in the map of an earlier one, of which `state` is: the camera is anywhere in it, and times start anew.
  /// The map grows. Throws as restore() does, also for keyframes with more features than TrackerOptions::features.
  void start_in(std::span<const uint8_t> state);
  Readout readout() const;

  struct Impl;                                      ///< internal/tracker_impl.h
  const Impl& internals() const { return *impl_; }  ///< for tests

 private:
  std::unique_ptr<Aligner> own_;  // made by a session; else null
  std::unique_ptr<Impl> impl_;
};

}  // namespace iclk
