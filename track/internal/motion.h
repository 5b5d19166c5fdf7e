#pragma once
#include <algorithm>
#include <optional>

#include <iclk/align/se3.h>

namespace iclk::internal {

/// The motion of the camera: the last frame with a pose, and the step before it.
struct Motion {
  /// The largest number of steps for which a motion is extrapolated.
  static constexpr double kLongestPrediction = 5;

  struct Last {
    double time = 0;
    SE3 T_WC;
  };
  std::optional<Last> last;
  std::optional<SE3> velocity;  ///< the step in `seconds`, in the frame of the camera
  double seconds = 1;
  bool lost = false;  ///< the previous frame had no pose

  /// The pose at `time` by constant velocity.
  SE3 predict(double time) const {
    if (!velocity) return last->T_WC;
    return last->T_WC * SE3::exp(std::min((time - last->time) / seconds, kLongestPrediction) * velocity->log());
  }
  void add(double time, const SE3& T_WC) {
    if (last && !lost) {
      velocity = last->T_WC.inverse() * T_WC;
      seconds = time - last->time;
    }
    lost = false;
    last = Last{time, T_WC};
  }
  void lose() {
    lost = true;
    velocity.reset();
  }
};

}  // namespace iclk::internal
