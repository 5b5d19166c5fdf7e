#pragma once
#include <vector>

#include <Eigen/Core>

namespace iclk::internal {

/// The turn rate of a camera, rad/s in its axes; `sigma` per axis.
struct TurnRate {
  Eigen::Vector3d rate = Eigen::Vector3d::Zero();
  double sigma = 0;

  /// Fuses this with another, independent estimate.
  TurnRate with(const Eigen::Vector3d& other, const Eigen::Matrix3d& covariance) const;
};

/// Estimates how much the turn rate changes between successive frames, from the last few dozen steps. This is the error of
/// predicting the turn rate at a frame from the step before it.
class RateChanges {
 public:
  void add(const Eigen::Vector3d& rate);  ///< of the next step, rad/s
  void interrupt() { follows_ = false; }  ///< the next step does not follow the last one
  double sigma() const;                   ///< rad/s per axis; with too few steps that of a hand-held camera
  /// Calls f(value...) with the complete state, to save or restore it.
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

/// Estimates the readout time: the turn while rows are read divided by the turn rate between frames. Each frame has a vote, so
/// the estimate is robust. Memory is constant.
class ReadoutEstimate {
 public:
  ReadoutEstimate();
  /// Adds a frame. `turn`: the whole turn while its rows were read, rad, with standard deviation `sigma` per axis; `rate`: the
  /// turn rate of the camera at that time, rad/s.
  void add(const Eigen::Vector3d& turn, double sigma, const Eigen::Vector3d& rate);
  double seconds() const;  ///< weighted median of the frames
  double sigma() const;    ///< s, from the scatter of the frames; infinite for too few
  /// Calls f(value...) with the complete state, to save or restore it.
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
