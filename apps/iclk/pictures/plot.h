#pragma once
#include <string>
#include <vector>

#include <opencv2/core.hpp>

namespace iclk {

/// A line through points, in the order given.
struct Curve {
  std::string name;
  std::vector<cv::Point2d> points;
  bool marks = false;  ///< a dot at every point
  bool line = true;    ///< from each point to the next
  bool steps = false;  ///< level to the next point, then up: a distribution of samples
};

/// One pair of axes. Both ranges are given: a reader compares panels.
struct Plot {
  std::string title, x_label, y_label;
  double x0 = 0, x1 = 1, y0 = 0, y1 = 1;
  bool log_x = false;    ///< decades as ticks; x0 > 0
  bool percent = false;  ///< y as per cent
  std::vector<Curve> curves = {};
  std::string note = {};  ///< faint, at the right of the title
};

/// Panels in rows of `columns`, one legend below for all: curves of one name have one colour everywhere, in the order in which
/// names first come. CV_8UC3.
cv::Mat draw_plots(const std::string& title, const std::vector<Plot>& plots, int columns);

}  // namespace iclk
