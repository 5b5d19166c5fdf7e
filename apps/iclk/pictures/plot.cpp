#include "apps/iclk/pictures/plot.h"

#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>

#include "apps/json/format.h"

namespace iclk {
namespace {

// Everything is drawn at twice the size and shrunk: OpenCV's letters are thin lines.
constexpr int kTwice = 2;
constexpr int kWidth = 620 * kTwice, kHeight = 430 * kTwice;  // of a panel
constexpr int kLeft = 86 * kTwice, kRight = 22 * kTwice, kTop = 44 * kTwice, kBottom = 58 * kTwice;

const cv::Scalar kGround(255, 255, 255), kText(40, 40, 40), kGrid(226, 226, 226), kAxis(110, 110, 110), kPale(140, 140, 140);
// Okabe and Ito's colours, which people with any kind of colour vision tell apart (BGR).
const cv::Scalar kColours[] = {{178, 114, 0},  {0, 94, 213}, {115, 158, 0}, {0, 159, 230}, {167, 121, 204},
                               {233, 180, 86}, {60, 60, 60}, {0, 0, 160},   {120, 120, 0}, {150, 150, 150}};

void write(cv::Mat& canvas, const std::string& words, cv::Point at, const cv::Scalar& colour = kText, double size = 0.5) {
  cv::putText(canvas, words, at, cv::FONT_HERSHEY_SIMPLEX, size * kTwice, colour, kTwice, cv::LINE_AA);
}

cv::Size size_of(const std::string& words, double size = 0.5) {
  int below = 0;
  return cv::getTextSize(words, cv::FONT_HERSHEY_SIMPLEX, size * kTwice, kTwice, &below);
}

void write_upwards(cv::Mat& canvas, const std::string& words, cv::Point centre) {
  const cv::Size size = size_of(words);
  cv::Mat strip(size.height + 12 * kTwice, size.width + 4 * kTwice, CV_8UC3, kGround), turned;
  write(strip, words, {2 * kTwice, size.height + 4 * kTwice});
  cv::rotate(strip, turned, cv::ROTATE_90_COUNTERCLOCKWISE);
  const cv::Rect at =
      cv::Rect(centre.x - turned.cols / 2, centre.y - turned.rows / 2, turned.cols, turned.rows) & cv::Rect({}, canvas.size());
  turned(cv::Rect(0, 0, at.width, at.height)).copyTo(canvas(at));
}

std::string number_text(double x) { return std::abs(x) < 1e-12 ? "0" : formatted("%.6g", x); }

/// About `count` round values in a range.
std::vector<double> ticks(double from, double to, int count) {
  const double raw = (to - from) / std::max(count, 1), power = std::pow(10, std::floor(std::log10(raw)));
  const double step = power * (raw / power < 1.5 ? 1 : raw / power < 3.5 ? 2 : raw / power < 7.5 ? 5 : 10);
  std::vector<double> out;
  for (double x = std::ceil(from / step - 1e-9) * step; x <= to + 1e-9 * step; x += step) out.push_back(x);
  return out;
}

struct Panel {
  const Plot& plot;
  cv::Mat canvas;
  cv::Rect area{kLeft, kTop, kWidth - kLeft - kRight, kHeight - kTop - kBottom};

  double along(double x) const {
    return plot.log_x ? std::log(std::max(x, 1e-300) / plot.x0) / std::log(plot.x1 / plot.x0)
                      : (x - plot.x0) / (plot.x1 - plot.x0);
  }
  cv::Point at(double x, double y) const {
    const double a = std::clamp(along(x), -0.5, 1.5), b = std::clamp((y - plot.y0) / (plot.y1 - plot.y0), -0.5, 1.5);
    return {area.x + static_cast<int>(std::lround(a * area.width)),
            area.y + area.height - static_cast<int>(std::lround(b * area.height))};
  }

  void axes() {
    std::vector<double> xs = ticks(plot.x0, plot.x1, 6);
    if (plot.log_x) {
      xs.clear();
      for (double x = std::pow(10, std::ceil(std::log10(plot.x0) - 1e-9)); x <= plot.x1 * 1.001; x *= 10) xs.push_back(x);
    }
    for (const double x : xs) {
      const cv::Point p = at(x, plot.y0);
      cv::line(canvas, p, {p.x, area.y}, kGrid, kTwice, cv::LINE_AA);
      const std::string text = number_text(x);
      write(canvas, text, {p.x - size_of(text).width / 2, p.y + 21 * kTwice});
    }
    for (const double y : ticks(plot.y0, plot.y1, 5)) {
      const cv::Point p = at(plot.x0, y);
      cv::line(canvas, p, {area.x + area.width, p.y}, kGrid, kTwice, cv::LINE_AA);
      const std::string text = plot.percent ? number_text(100 * y) + " %" : number_text(y);
      write(canvas, text, {p.x - 8 * kTwice - size_of(text).width, p.y + 5 * kTwice});
    }
    cv::line(canvas, at(plot.x0, plot.y0), at(plot.x1, plot.y0), kAxis, kTwice, cv::LINE_AA);
    cv::line(canvas, at(plot.x0, plot.y0), at(plot.x0, plot.y1), kAxis, kTwice, cv::LINE_AA);
    write(canvas, plot.title, {area.x, 26 * kTwice}, kText, 0.56);
    write(canvas, plot.x_label, {area.x + (area.width - size_of(plot.x_label).width) / 2, kHeight - 16 * kTwice});
    write_upwards(canvas, plot.y_label, {14 * kTwice, area.y + area.height / 2});
    write(canvas, plot.note, {area.x + area.width - size_of(plot.note, 0.42).width, 26 * kTwice}, kPale, 0.42);
  }

  void curve(const Curve& c, const cv::Scalar& colour, int order) {
    // Curves that lie upon each other at 0 or 100 % are kept apart by a hair.
    const cv::Point aside(0, (order % 3 - 1) * kTwice);
    cv::Mat inside = canvas(area);
    const cv::Point corner = area.tl();
    std::vector<cv::Point> line;
    for (const cv::Point2d& p : c.points) {
      const cv::Point next = at(p.x, p.y) - corner + aside;
      if (c.steps && !line.empty()) line.emplace_back(next.x, line.back().y);
      line.push_back(next);
    }
    if (c.line) cv::polylines(inside, line, false, colour, 2 * kTwice, cv::LINE_AA);
    if (c.marks)
      for (const cv::Point2d& p : c.points)
        cv::circle(canvas, at(p.x, p.y) + aside, 4 * kTwice, colour, cv::FILLED, cv::LINE_AA);
  }
};

}  // namespace

cv::Mat draw_plots(const std::string& title, const std::vector<Plot>& plots, int columns) {
  std::vector<std::string> names;
  for (const Plot& plot : plots)
    for (const Curve& curve : plot.curves)
      if (std::find(names.begin(), names.end(), curve.name) == names.end()) names.push_back(curve.name);
  columns = std::clamp(columns, 1, std::max<int>(1, static_cast<int>(plots.size())));
  const int rows = (static_cast<int>(plots.size()) + columns - 1) / columns, width = columns * kWidth;
  // The legend breaks into as many lines as it takes.
  struct Entry {
    cv::Point at;
    size_t name;
  };
  std::vector<Entry> legend;
  cv::Point next(kLeft, 0);
  for (size_t i = 0; i < names.size(); ++i) {
    const int needed = 66 * kTwice + size_of(names[i]).width;
    if (next.x + needed > width && next.x > kLeft) next = {kLeft, next.y + 26 * kTwice};
    legend.push_back({next, i});
    next.x += needed;
  }
  const int head = 44 * kTwice, foot = next.y + 40 * kTwice;
  cv::Mat canvas(head + rows * kHeight + foot, width, CV_8UC3, kGround);
  write(canvas, title, {24 * kTwice, 30 * kTwice}, kText, 0.66);
  for (size_t i = 0; i < plots.size(); ++i) {
    const int column = static_cast<int>(i) % columns, row = static_cast<int>(i) / columns;
    Panel panel{plots[i], canvas(cv::Rect(column * kWidth, head + row * kHeight, kWidth, kHeight))};
    panel.axes();
    for (const Curve& curve : plots[i].curves) {
      const auto colour = static_cast<size_t>(std::find(names.begin(), names.end(), curve.name) - names.begin());
      panel.curve(curve, kColours[colour % std::size(kColours)], static_cast<int>(colour));
    }
  }
  for (const Entry& entry : legend) {
    const cv::Point at(entry.at.x, head + rows * kHeight + entry.at.y + 14 * kTwice);
    cv::line(canvas, at, at + cv::Point(28 * kTwice, 0), kColours[entry.name % std::size(kColours)], 3 * kTwice, cv::LINE_AA);
    write(canvas, names[entry.name], at + cv::Point(36 * kTwice, 5 * kTwice));
  }
  cv::Mat out;
  cv::resize(canvas, out, {}, 1.0 / kTwice, 1.0 / kTwice, cv::INTER_AREA);
  return out;
}

}  // namespace iclk
