#pragma once
#include <optional>

#include <iclk/refine/internal/turn.h>
#include <iclk/track/internal/judge.h>
#include <iclk/track/internal/motion.h>
#include <iclk/track/internal/turn_rate.h>
#include <iclk/track/internal/unroll.h>

namespace iclk::internal {

/// Corrects rolling shutters: estimates the turn rate of the camera, and unrolls frames with it.
class Unroller {
 public:
  Unroller(const Camera& camera, const TrackerOptions& options, const Judge& judge, Refiner& refiner)
      : camera_(camera),
        rows_(options.rows.value_or(RowTimes(camera))),
        readout_(options.readout),
        judge_(judge),
        refiner_(refiner) {}

  /// Unrolls a frame with the rate of the last frame. The pixels stay in this unroller until it unrolls again.
  void unroll(Frame& frame);
  /// Returns a frame unrolled with the rate `with`; its pixels are in `to` if the shutter rolls.
  TrackFrame unrolled(const TrackFrame& frame, const Eigen::Vector3d& with, FramePixels& to) const;
  /// Unrolls a frame with Frame::rate, if another rate was used.
  void straighten(Frame& frame);
  /// Estimates pose and rate together.
  void unroll_again(Frame& frame, const Keyframe& k, const Motion& motion, Found& found);
  /// Updates the state from a frame's pose: turn rate, remaining bend of its rows, and readout time.
  void learn(const Frame& frame, const Keyframe& k, const Found& found, const Motion& motion, const SE3& T_WC);
  /// Begins a new map. The bend of its first frame is unknown; that of other frames is relative to it.
  void begin() { state.bent = {}; }
  void lose();

  struct State {
    Eigen::Vector3d rate = Eigen::Vector3d::Zero();  ///< angular velocity at the last frame, rad/s, in its axes
    RateChanges changes;
    ReadoutEstimate readout;
    /// The remaining bend of the last frame's rows: Keyframe::turn, its sigma, and seen_turn.
    struct Bent {
      Eigen::Vector3d turn = Eigen::Vector3d::Zero();
      double sigma = 0;
      Eigen::Vector3d seen = Eigen::Vector3d::Zero();
    } bent;
    /// Data of the last frame, until the next one gives its turn rate.
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
