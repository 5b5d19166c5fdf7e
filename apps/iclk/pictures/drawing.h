#pragma once
#include <string>

#include <opencv2/core.hpp>

namespace iclk {

// What the pictures of results and of evaluations are drawn with.

inline const cv::Scalar kPaper(32, 30, 28), kInk(235, 235, 235), kFaint(165, 165, 165), kAlarm(80, 90, 255);

/// The whole factor by which a small image is enlarged, so that marks and text stay readable.
int zoom_of(const cv::Mat& image);
cv::Mat enlarged(const cv::Mat& image, int zoom, int how);
cv::Mat enlarged(const cv::Mat& image, int zoom);

/// 8-bit colour for the eye; the colours of deeper images are not kept.
cv::Mat colour_8bit(const cv::Mat& image);

/// Letters and marks of a picture grow with its width: it is looked at as a whole, whatever its pixels.
struct Pen {
  double scale;  ///< 1 for a picture of 1280 px

  explicit Pen(int width);
  int px(double length) const;
  double font() const { return 0.62 * scale; }
  int thickness() const { return px(1.2); }
  void text(cv::Mat& canvas, const std::string& words, cv::Point at, const cv::Scalar& colour = kInk) const;
  int width(const std::string& words) const;
};

/// A title above and room for a legend below.
cv::Mat framed(const cv::Mat& panel, const Pen& pen, const std::string& title, const cv::Scalar& colour, int legend_height);

/// Entries of a legend, from left to right along one line.
struct Legend {
  cv::Mat& canvas;
  const Pen& pen;
  int y;  ///< the text's base line
  int x = pen.px(16);

  void words(const std::string& text, double gap);
  void square(const cv::Scalar& colour, const std::string& text);
  void ring(const cv::Scalar& colour, const std::string& text);
  void line(const cv::Scalar& colour, const std::string& text);
  /// Faint, at the right end.
  void note(const std::string& text);
};

}  // namespace iclk
