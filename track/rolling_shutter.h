#pragma once
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/refine/rolling_shutter.h>
#include <iclk/track/keyframes.h>
#include <iclk/track/tracker.h>

namespace iclk {

/// The frame as a camera sees it that reads all its rows at once, at the frame's time. `turn`: rotation vector of the camera's
/// motion while its rows were read, rad, in its own axes; taken as even. `rows`: when it saw the frame's pixels. What the
/// camera shifts meanwhile stays in: it would need the depth of every pixel. Image: bilinear. Depth, as rolling as the image,
/// and mask: nearest. Where the source has nothing the mask is 0; without one in `frame`, so it is made.
void unroll(const TrackFrame& frame, const Camera& camera, const RowTimes& rows, const Eigen::Vector3d& turn, FramePixels& out);

/// Where a pixel of an image that was unrolled with the turn `from` is found in one that is unrolled with `to`.
Eigen::Vector2d unrolled_anew(const Camera& camera, const RowTimes& rows, const Eigen::Vector3d& from,
                              const Eigen::Vector3d& to, const Eigen::Vector2d& uv);

/// How fast a camera turns: rad/s, in its axes, `sigma` an axis.
struct TurnRate {
  Eigen::Vector3d rate = Eigen::Vector3d::Zero();
  double sigma = 0;

  /// Taken together with another estimate that is independent of it.
  TurnRate with(const Eigen::Vector3d& other, const Eigen::Matrix3d& covariance) const;
};

/// How much the rate of turning changes from one step between frames to the next: so far is the rate at a frame from that of
/// the step before it. Of the last steps, a few dozen.
class RateChanges {
 public:
  void add(const Eigen::Vector3d& rate);  ///< of the next step, rad/s
  void interrupt() { follows_ = false; }  ///< the next step does not follow the last
  double sigma() const;                   ///< rad/s an axis; for too few that of a camera in a hand
  /// Calls f(value...) with all that it knows, to be kept or set.
  template <class F>
  void archive(const F& f) {
    f(last_, follows_, square_, count_);
  }

 private:
  Eigen::Vector3d last_ = Eigen::Vector3d::Zero();
  bool follows_ = false;
  double square_ = 0;
  int count_ = 0;
};

/// How long the readout takes: turns while rows are read, over how fast the camera turned from frame to frame. Frames vote, so
/// that bad ones do not matter; memory does not grow.
class ReadoutEstimate {
 public:
  ReadoutEstimate();
  /// `turn`: rad, in all, of standard deviation `sigma` an axis; `rate`: rad/s, of the same camera at that time.
  void add(const Eigen::Vector3d& turn, double sigma, const Eigen::Vector3d& rate);
  double seconds() const;  ///< weighted median of the frames
  /// Calls f(value...) with all that it knows, to be kept or set.
  template <class F>
  void archive(const F& f) {
    f(votes_, weight_, weight2_);
  }
  double sigma() const;  ///< s, from how the frames scatter; infinite for too few

 private:
  double quantile(double share) const;

  std::vector<double> votes_;  ///< weights by turn over rate
  double weight_ = 0, weight2_ = 0;
};

}  // namespace iclk
