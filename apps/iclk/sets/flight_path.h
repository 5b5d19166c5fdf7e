#pragma once
#include <vector>

#include <iclk/align/se3.h>
#include <iclk/session/io/pose_text.h>

namespace iclk {

/// A camera's way through given poses: smooth between them, exact at them. Translation and rotation are a Catmull-Rom curve
/// each, with the times as knots (Barry and Goldman's scheme, on SO(3) with geodesics in place of lines): velocities have no
/// jumps. Through poses of an even motion it is that motion.
class FlightPath {
 public:
  /// Throws Error(invalid_argument), which `source` opens: no pose, two poses of one time, times below 0 or beyond 9e9 s.
  FlightPath(std::vector<StampedPose> poses, const std::string& source);

  double begin() const { return poses_.front().stamp; }
  double end() const { return poses_.back().stamp; }
  const std::vector<StampedPose>& poses() const { return poses_; }

  /// Camera to world at a time; that of the nearer end outside begin() .. end().
  SE3 at(double time) const;

  /// When frames are taken: at the poses' own times, or `rate` a second from begin() on, where rate is not 0. Only those whose
  /// `readout` (s), half before and half after, lies in begin() .. end(). May be empty.
  std::vector<double> times(double rate, double readout) const;

 private:
  std::vector<StampedPose> poses_;
};

}  // namespace iclk
