#include "apps/iclk/pictures/drawing.h"

#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>

#include "apps/iclk/io/images.h"

namespace iclk {
namespace {

constexpr int kPanelWidth = 960;  // px, at least

}  // namespace

int zoom_of(const cv::Mat& image) { return std::clamp((kPanelWidth + image.cols - 1) / std::max(image.cols, 1), 1, 16); }

cv::Mat enlarged(const cv::Mat& image, int zoom, int how) {
  cv::Mat out;
  cv::resize(image, out, {}, zoom, zoom, how);
  return out;
}

cv::Mat enlarged(const cv::Mat& image, int zoom) { return enlarged(image, zoom, cv::INTER_LINEAR); }

cv::Mat colour_8bit(const cv::Mat& image) {
  if (image.type() == CV_8UC3) return image;
  cv::Mat out;
  cv::cvtColor(grey_8bit(image), out, cv::COLOR_GRAY2BGR);
  return out;
}

Pen::Pen(int width) : scale(std::clamp(width / 1280.0, 0.75, 8.0)) {}

int Pen::px(double length) const { return std::max(1, static_cast<int>(std::lround(length * scale))); }

void Pen::text(cv::Mat& canvas, const std::string& words, cv::Point at, const cv::Scalar& colour) const {
  cv::putText(canvas, words, at, cv::FONT_HERSHEY_SIMPLEX, font(), colour, thickness(), cv::LINE_AA);
}

int Pen::width(const std::string& words) const {
  int below = 0;
  return cv::getTextSize(words, cv::FONT_HERSHEY_SIMPLEX, font(), thickness(), &below).width;
}

cv::Mat framed(const cv::Mat& panel, const Pen& pen, const std::string& title, const cv::Scalar& colour, int legend_height) {
  const int top = pen.px(34);
  cv::Mat canvas(panel.rows + top + legend_height, panel.cols, CV_8UC3, kPaper);
  panel.copyTo(canvas(cv::Rect(0, top, panel.cols, panel.rows)));
  pen.text(canvas, title, {pen.px(12), pen.px(24)}, colour);
  return canvas;
}

void Legend::words(const std::string& text, double gap) {
  pen.text(canvas, text, {x, y});
  x += pen.width(text) + pen.px(gap);
}

void Legend::square(const cv::Scalar& colour, const std::string& text) {
  cv::rectangle(canvas, cv::Rect(x, y - pen.px(14), pen.px(18), pen.px(18)), colour, cv::FILLED);
  x += pen.px(26);
  words(text, 26);
}

void Legend::ring(const cv::Scalar& colour, const std::string& text) {
  cv::circle(canvas, {x + pen.px(6), y - pen.px(5)}, pen.px(7), colour, pen.px(2), cv::LINE_AA);
  x += pen.px(22);
  words(text, 28);
}

void Legend::line(const cv::Scalar& colour, const std::string& text) {
  cv::line(canvas, {x, y - pen.px(5)}, {x + pen.px(28), y - pen.px(5)}, colour, pen.px(2), cv::LINE_AA);
  x += pen.px(40);
  words(text, 28);
}

void Legend::note(const std::string& text) {
  pen.text(canvas, text, {std::max(x, canvas.cols - pen.px(16) - pen.width(text)), y}, kFaint);
}

}  // namespace iclk
