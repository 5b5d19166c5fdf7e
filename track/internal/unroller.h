#pragma once
#include <optional>

#include <iclk/refine/internal/turn.h>
#include <iclk/track/internal/judge.h>
#include <iclk/track/internal/motion.h>
#include <iclk/track/internal/turn_rate.h>
#include <iclk/track/internal/unroll.h>

namespace iclk::internal {

/// Rolling shutters: how fast the camera turns, and frames unrolled by it.
class Unroller {
 public:
  Unroller(const Camera& camera, const TrackerOptions& options, const Judge& judge, Refiner& refiner)
      : camera_(camera),
        rows_(options.rows.value_or(RowTimes(camera))),
        readout_(options.readout),
        judge_(judge),
        refiner_(refiner) {}

  /// With the rate of the last frame. Pixels are in this unroller until it unrolls again.
  void unroll(Frame& frame);
  /// A frame as it is seen with a rate; in `to`, if the shutter rolls.
  TrackFrame unrolled(const TrackFrame& frame, const Eigen::Vector3d& with, FramePixels& to) const;
  /// With the frame's own rate, if it was seen with another one.
  void straighten(Frame& frame);
  /// Finds pose and rate together.
  void unroll_again(Frame& frame, const Keyframe& k, const Motion& motion, Found& found);
  /// By a frame's pose: how fast the camera turned, what its rows are still bent by, and how long the readout takes.
  void learn(const Frame& frame, const Keyframe& k, const Found& found, const Motion& motion, const SE3& T_WC);
  /// A new map: whatever its first frame is bent by, the others are seen in relation to it.
  void begin() { state.bent = {}; }
  void lose();

  struct State {
    Eigen::Vector3d rate = Eigen::Vector3d::Zero();  ///< angular velocity at the last frame, rad/s, in its axes
    RateChanges changes;
    ReadoutEstimate readout;
    /// What the last frame's rows are still bent by: Keyframe::turn, its sigma, and seen_turn.
    struct Bent {
      Eigen::Vector3d turn = Eigen::Vector3d::Zero();
      double sigma = 0;
      Eigen::Vector3d seen = Eigen::Vector3d::Zero();
    } bent;
    /// Of the last frame, until the next one tells how fast it turned.
    struct Turned {
      double time = 0, time_before = 0;
      SE3 T_WC_before;
      Eigen::Vector3d turn = Eigen::Vector3d::Zero();
      double sigma = 0;
    };
    std::optional<Turned> turned;
  } state;

 private:
  void see(Frame& frame, const Eigen::Vector3d& with);
  std::optional<TurnEstimate> seen_turn(const Keyframe& k, const RefinedAlignment& a, const Eigen::Vector3d& turn_0) const;
  TurnRate rate_by(const std::optional<Eigen::Vector3d>& step, const Keyframe& k,
                   const std::optional<TurnEstimate>& seen) const;
  bool pose_with(const Eigen::Vector3d& now, const Keyframe& k, Found& found) const;
  bool align_with(const Eigen::Vector3d& now, Frame& frame, const Keyframe& k, const SE3& T_WC, Found& found);

  Camera camera_;
  RowTimes rows_;
  double readout_;
  const Judge& judge_;
  Refiner& refiner_;
  FramePixels flat_;
  Eigen::Vector3d flat_rate_ = Eigen::Vector3d::Zero();
};

}  // namespace iclk::internal
