#pragma once
#include <functional>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>

namespace iclk {

/// The time at which row v of an image was read, as a share of the readout: -0.5 at the first row, 0.5 at the last. The time of
/// the frame is 0.
inline double row_time(const Camera& camera, double v) { return (v + 0.5) / camera.height - 0.5; }

/// The time at which each pixel was read, as in row_time(), for original and for resampled images. The rows of a resampled
/// image, for example an undistorted one, are not the rows of the camera.
class RowTimes {
 public:
  /// For an original image: row_time().
  explicit RowTimes(const Camera& camera);
  /// For a resampled image. `time` is called at nodes 16 px apart, some of them beyond the right and lower border of the image;
  /// times in between are interpolated.
  RowTimes(const Camera& camera, const std::function<double(const Eigen::Vector2d&)>& time);

  /// The time at uv. Outside a resampled image it is that of the nearest border pixel.
  double at(const Eigen::Vector2d& uv) const;

 private:
  Camera camera_;
  int columns_ = 0;
  std::vector<double> nodes_;  ///< row by row; empty: an original image
};

}  // namespace iclk
