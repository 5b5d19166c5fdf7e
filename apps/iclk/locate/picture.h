#pragma once
#include <opencv2/core.hpp>

#include "apps/iclk/locate/run.h"

namespace iclk {

/// A picture as Locator takes it.
struct LocatePicture {
  Camera camera;
  cv::Mat image;  ///< undistorted
  cv::Mat seen;   ///< CV_8UC1, 0 at the border of the undistorted image; empty: no lens

  /// `image`: as the camera took it. Throws Error(invalid_argument) if the camera is of another size. Precondition: the run's
  /// camera is known.
  LocatePicture(const LocateRun& run, const cv::Mat& image);
};

/// Sets the footprint of a frame that was located. Returns its overlay, PNG bytes.
std::string draw_located(const LocatePicture& picture, Locator& locator, LocatedFrame& frame);

}  // namespace iclk
