#pragma once
#include <algorithm>
#include <optional>

#include <iclk/align/se3.h>

namespace iclk::internal {

/// How the camera moved: the last frame with a pose, and the step that led there.
struct Motion {
  /// Steps that are repeated more often say nothing any more.
  static constexpr double kLongestPrediction = 5;

  struct Last {
    double time = 0;
    SE3 T_WC;
  };
  std::optional<Last> last;
  std::optional<SE3> velocity;  ///< the step in `seconds`, in the camera's own frame
  double seconds = 1;
  bool lost = false;  ///< the frame before had no pose

  /// By constant velocity.
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
