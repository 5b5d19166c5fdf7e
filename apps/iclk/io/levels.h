#pragma once
#include <initializer_list>
#include <vector>

#include <opencv2/core.hpp>

namespace iclk {

/// Black and white of 16-bit images whose values fill less than a quarter of the 16 bits, as those of cameras with 10 to 14
/// bits and of thermal ones do. Images of one pair and of one sequence have one.
class Levels {
 public:
  Levels() = default;  ///< changes nothing
  /// Of images that load_image() gave; those of other types say nothing.
  explicit Levels(std::initializer_list<cv::Mat> images);
  explicit Levels(const std::vector<cv::Mat>& images);

  /// In place, of 16-bit images; what is darker than black or brighter than white is cut off.
  void apply(cv::Mat& image) const;

 private:
  cv::Mat table_;  ///< CV_16UC1, 65536 values; empty: as they are
};

}  // namespace iclk
