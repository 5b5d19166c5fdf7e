#pragma once
#include <vector>

#include <Eigen/Core>

namespace iclk::internal {

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
  double sigma() const;    ///< s, from how the frames scatter; infinite for too few
  /// Calls f(value...) with all that it knows, to be kept or set.
  template <class F>
  void archive(const F& f) {
    f(votes_, weight_, weight2_);
  }

 private:
  double quantile(double share) const;

  std::vector<double> votes_;  ///< weights by turn over rate
  double weight_ = 0, weight2_ = 0;
};

}  // namespace iclk::internal
