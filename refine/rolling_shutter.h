#pragma once
#include <functional>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>

namespace iclk {

/// When row v of an image was seen, as a share of the readout: -0.5 at the first row, 0.5 at the last, 0 at the frame's time.
inline double row_time(const Camera& camera, double v) { return (v + 0.5) / camera.height - 0.5; }

/// The same of every pixel, also of an image that was resampled from what the camera read, so that its rows are not the
/// camera's.
class RowTimes {
 public:
  /// Of an image as it was read: row_time().
  explicit RowTimes(const Camera& camera);
  /// Of an image that was resampled, as by undoing a lens. `time` is asked at nodes 16 px apart, a few of them beyond the
  /// image's right and lower border; in between it is interpolated.
  RowTimes(const Camera& camera, const std::function<double(const Eigen::Vector2d&)>& time);

  double at(const Eigen::Vector2d& uv) const;  ///< beyond the image that of the nearest border pixel, if it was resampled

 private:
  Camera camera_;
  int columns_ = 0;
  std::vector<double> nodes_;  ///< row by row; empty: the image is as it was read
};

}  // namespace iclk
