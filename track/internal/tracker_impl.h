#pragma once
// State of a Tracker: track() and keyframes (tracker.cpp), where a frame is (find_pose.cpp), keyframes together (window.cpp),
// rolling shutters (turning.cpp), depths by motion (seeds.cpp).
#include <optional>

#include <iclk/refine/internal/turn.h>
#include <iclk/track/rolling_shutter.h>
#include <iclk/track/tracker.h>

namespace iclk {

struct Tracker::Impl {
  /// A pose of a frame, by its alignment with a keyframe.
  struct Found {
    int keyframe = 0;
    RefinedAlignment alignment;
    bool confirmed = true;
  };
  struct Last {
    double time = 0;
    SE3 T_WC;
  };
  /// A keyframe near a new one, and how they were aligned: `there` is the new one's frame with that one, `back` the other way.
  struct Neighbour {
    int id = 0;
    RefinedAlignment there, back;
  };

  Impl(Aligner& aligner, const Camera& camera, const TrackerOptions& options);

  // find_pose.cpp
  /// Sets `searched` and `before` of the result.
  std::optional<Found> find_pose(const TrackFrame& frame, TrackResult& result);
  std::optional<Found> try_others(const TrackFrame& frame, const SE3& expected, std::optional<Found>& weak);
  std::optional<Found> try_previous(const TrackFrame& frame, const SE3& expected, std::optional<Found>& weak,
                                    TrackResult& result);
  std::optional<Found> relocalise(const TrackFrame& frame);
  SE3 predict(double time) const;
  Pair pair_with(int id, const TrackFrame& frame, const SE3& T_WC, bool search);
  bool confirmed(const RefinedAlignment& a) const;
  bool credible(const RefinedAlignment& a, const Keyframe& k, const SE3& expected) const;
  /// Keeps the better one of what is only credible.
  void consider(int id, const RefinedAlignment& a, const SE3& expected, std::optional<Found>& weak);

  // turning.cpp
  bool rolls() const { return options.readout != 0; }
  /// In `flat`, until the next call.
  TrackFrame unrolled(const TrackFrame& frame, const Eigen::Vector3d& with);
  /// By the step from the last frame; nothing where that is too long ago.
  std::optional<Eigen::Vector3d> step_rate(double time, const SE3& T_WC) const;
  /// `turn_0`: the keyframe's.
  std::optional<internal::TurnEstimate> seen_turn(const Found& found, const Eigen::Vector3d& turn_0) const;
  /// By the step and by how the image, unrolled with `rate`, is still bent.
  TurnRate rate_at(double time, const SE3& T_WC, const Found& found, const std::optional<internal::TurnEstimate>& seen) const;
  /// The pose by the features that were found, as they lie with the rate `now`; without looking at the image again. False if
  /// they agree no longer.
  bool pose_with(const Eigen::Vector3d& now, Found& found) const;
  /// Finds pose and `rate` together.
  void unroll_again(const TrackFrame& given, Found& found);
  void learn_turn(const Found& found, double time, const SE3& T_WC);

  // tracker.cpp
  bool can_begin(const TrackFrame& frame) const;
  void begin(const TrackFrame& frame, TrackResult& result);
  /// The features that are found in a frame do not agree, since the keyframe's depths are too coarse for how far it is.
  bool disagree(const Keyframe& k, const RefinedAlignment& a) const;
  void lose();
  bool make_keyframe(const TrackFrame& frame, const SE3& T_WC, const std::optional<Keyframe::Origin>& origin,
                     const Found* found, TrackResult& result);
  void set_reference(const Keyframe& k);

  // seeds.cpp
  /// Adds features of the neighbours that were found in the frame, where it has no depth and no feature yet.
  void carry(const TrackFrame& frame, const std::vector<Neighbour>& neighbours, int most, Features& to) const;
  void sow(Keyframe& k, const Map& grey, const TrackFrame& frame);
  /// Looks for the seeds of a keyframe, whose pyramid is `f0`, in another image.
  void sight(Keyframe& k, const Pyramid& f0, const Pyramid& f1, const SE3& T_10, const Matrix6d& covariance);
  /// Makes features of the seeds that are known by now, if there are so many. How many became features.
  int harvest(Keyframe& k, int least);
  Pyramid pyramid(const TrackFrame& frame) const;
  void look_back(Keyframe& k, const std::vector<Neighbour>& neighbours);
  void look(Keyframe& k, const TrackFrame& frame, const RefinedAlignment& a);

  // window.cpp
  /// `found`: the frame's alignment with one of them, if there is one.
  std::vector<Neighbour> neighbours_of(const TrackFrame& frame, const SE3& T_WC, const Found* found);
  void connect(Keyframe& k, std::vector<Neighbour>& neighbours);
  void adjust_window();

  Aligner& aligner;
  Camera camera;
  TrackerOptions options;
  RowTimes rows;
  Refiner refiner;
  Keyframes keyframes;
  int current = 0;           ///< keyframe that the last frame was aligned with
  std::optional<Last> last;  ///< frame with a pose
  FramePixels previous;      ///< of that frame, which may have to become a keyframe after all; as it came
  Eigen::Vector3d previous_rate = Eigen::Vector3d::Zero();  ///< to unroll it with
  std::optional<Keyframe::Origin> previous_origin;
  std::optional<SE3> velocity;  ///< motion of the camera in velocity_seconds, in its own frame
  double velocity_seconds = 1;
  Eigen::Vector3d rate = Eigen::Vector3d::Zero();  ///< angular velocity at the last frame, rad/s, in its axes
  RateChanges rate_changes;
  /// What the last frame's rows are still bent by: Keyframe::turn, its sigma, and seen_turn.
  struct Bent {
    Eigen::Vector3d turn = Eigen::Vector3d::Zero();
    double sigma = 0;
    Eigen::Vector3d seen = Eigen::Vector3d::Zero();
  };
  Bent bent;
  /// Of the last frame, until the next one tells how fast it turned.
  struct Turned {
    double time = 0, time_before = 0;
    SE3 T_WC_before;
    Eigen::Vector3d turn = Eigen::Vector3d::Zero();
    double sigma = 0;
  };
  std::optional<Turned> turned;
  FramePixels flat;  ///< the frame at hand, unrolled with flat_rate
  Eigen::Vector3d flat_rate = Eigen::Vector3d::Zero();
  int looked_at = -1;  ///< keyframe whose pyramid this is: kept from frame to frame
  Pyramid looked_pyramid;
  ReadoutEstimate readout;
  bool lost = false;
  int map = 0;
  int64_t frames_tracked = 0, frames_lost = 0;  ///< of this map: in all; since it had the camera last
  int next_tried = 0;                           ///< where relocalise() goes on among the keyframes
  std::optional<double> last_time;              ///< of any frame
};

}  // namespace iclk
