#include "apps/pictures.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>

#include <opencv2/imgproc.hpp>

#include "apps/metrics.h"
#include "apps/report.h"

namespace iclk {
namespace {

constexpr int kPanelWidth = 960;  // px, at least, so that marks and text stay readable
const cv::Scalar kPaper(32, 30, 28), kInk(235, 235, 235), kFaint(165, 165, 165);

int zoom_of(const cv::Mat& image) { return std::clamp((kPanelWidth + image.cols - 1) / std::max(image.cols, 1), 1, 16); }

cv::Mat enlarged(const cv::Mat& image, int zoom, int how = cv::INTER_LINEAR) {
  cv::Mat out;
  cv::resize(image, out, {}, zoom, zoom, how);
  return out;
}

void text(cv::Mat& canvas, const std::string& words, cv::Point at, double size = 0.62, const cv::Scalar& colour = kInk) {
  cv::putText(canvas, words, at, cv::FONT_HERSHEY_SIMPLEX, size, colour, 1, cv::LINE_AA);
}

int text_width(const std::string& words, double size = 0.62) {
  int below = 0;
  return cv::getTextSize(words, cv::FONT_HERSHEY_SIMPLEX, size, 1, &below).width;
}

std::string format(const char* pattern, auto... values) {
  char line[256];
  std::snprintf(line, sizeof line, pattern, values...);
  return line;
}

/// A title above and room for a legend below.
cv::Mat framed(const cv::Mat& panel, const std::string& title, int legend_height) {
  cv::Mat canvas(panel.rows + 34 + legend_height, panel.cols, CV_8UC3, kPaper);
  panel.copyTo(canvas(cv::Rect(0, 34, panel.cols, panel.rows)));
  text(canvas, title, {12, 24}, std::min(0.62, 0.62 * (panel.cols - 24) / std::max(text_width(title), 1)));
  return canvas;
}

/// Gain and bias that bring the warped target to the reference's exposure: pictures show motion, not exposure.
/// Least squares on the better half of the pixels, twice.
void match_exposure(cv::Mat& warped, const cv::Mat& grey_0) {
  double gain = 1, bias = 0, limit = 1e9;
  for (int round = 0; round < 3; ++round) {
    double n = 0, sx = 0, sy = 0, sxx = 0, sxy = 0;
    std::vector<double> errors;
    for (int v = 0; v < warped.rows; ++v)
      for (int u = 0; u < warped.cols; ++u) {
        const double x = warped.at<float>(v, u), y = grey_0.at<uchar>(v, u);
        if (std::isnan(x)) continue;
        const double e = std::abs(gain * x + bias - y);
        errors.push_back(e);
        if (e > limit) continue;
        n += 1, sx += x, sy += y, sxx += x * x, sxy += x * y;
      }
    const double spread = n * sxx - sx * sx;
    if (n < 16 || spread < 1e-6 * n * n) return;
    gain = std::clamp((n * sxy - sx * sy) / spread, 0.2, 5.0);
    bias = (sy - gain * sx) / n;
    std::nth_element(errors.begin(), errors.begin() + static_cast<long>(errors.size() / 2), errors.end());
    limit = 2 * errors[errors.size() / 2] + 1;
  }
  warped = gain * warped + bias;
}

/// What both pictures of a pose need.
struct View {
  cv::Mat warped;  ///< exposure matched, NaN = unknown
  double rms = NAN;
};

View view_by(const PairInput& pair, const cv::Mat& grey_0, const cv::Mat& grey_1, const cv::Mat& depth, const SE3& T_10) {
  View view{warp_target(grey_1, depth, pair.camera, T_10)};
  match_exposure(view.warped, grey_0);
  double sum = 0, n = 0;
  for (int v = 0; v < grey_0.rows; ++v)
    for (int u = 0; u < grey_0.cols; ++u)
      if (const float x = view.warped.at<float>(v, u); !std::isnan(x)) {
        sum += (x - grey_0.at<uchar>(v, u)) * (x - grey_0.at<uchar>(v, u));
        n += 1;
      }
  if (n > 0) view.rms = std::sqrt(sum / n);
  return view;
}

/// Reference in red, target in cyan: grey where they agree.
cv::Mat overlay_panel(const View& view, const cv::Mat& grey_0) {
  cv::Mat out(grey_0.size(), CV_8UC3);
  for (int v = 0; v < out.rows; ++v)
    for (int u = 0; u < out.cols; ++u) {
      const uchar g0 = grey_0.at<uchar>(v, u);
      const float x = view.warped.at<float>(v, u);
      const uchar g1 = std::isnan(x) ? 0 : cv::saturate_cast<uchar>(x);
      out.at<cv::Vec3b>(v, u) = std::isnan(x) ? cv::Vec3b(g0 / 4 + 24, g0 / 4 + 8, g0 / 4 + 8) : cv::Vec3b(g1, g1, g0);
    }
  return out;
}

/// Blue where the target is darker, red where it is brighter, white where they agree.
cv::Vec3b signed_colour(double x) {
  const double t = std::clamp(x, -1.0, 1.0), fade = 1 - std::pow(std::abs(t), 0.7);
  const cv::Vec3d hot(30, 30, 190), cold(190, 80, 20), end = t > 0 ? hot : cold,
                                                       mixed = (1 - fade) * end + fade * cv::Vec3d(250, 250, 250);
  return {cv::saturate_cast<uchar>(mixed[0]), cv::saturate_cast<uchar>(mixed[1]), cv::saturate_cast<uchar>(mixed[2])};
}

cv::Mat residual_panel(const View& view, const cv::Mat& grey_0, double range) {
  cv::Mat out(grey_0.size(), CV_8UC3, cv::Scalar(96, 96, 96));
  for (int v = 0; v < out.rows; ++v)
    for (int u = 0; u < out.cols; ++u)
      if (const float x = view.warped.at<float>(v, u); !std::isnan(x))
        out.at<cv::Vec3b>(v, u) = signed_colour((x - grey_0.at<uchar>(v, u)) / range);
  return out;
}

cv::Mat side_by_side(const cv::Mat& before, const cv::Mat& after, const std::string& title_0, const std::string& title_1,
                     int legend_height) {
  const cv::Mat gap(before.rows + 34 + legend_height, 8, CV_8UC3, kPaper);
  cv::Mat out;
  cv::hconcat(std::vector<cv::Mat>{framed(before, title_0, legend_height), gap, framed(after, title_1, legend_height)}, out);
  return out;
}

cv::Scalar status_colour(const std::string& status) {
  static const std::map<std::string, cv::Scalar> colours = {{"aligned", {90, 230, 90}},
                                                            {"projected", {90, 230, 90}},
                                                            {"bad_match", {40, 160, 255}},
                                                            {"diverged", {255, 90, 230}},
                                                            {"low_texture", {255, 220, 60}}};
  const auto it = colours.find(status);
  return it == colours.end() ? cv::Scalar(150, 150, 150) : it->second;
}

/// 8-bit colour for the eye; the colours of deeper images are not kept.
cv::Mat colour_8bit(const cv::Mat& image) {
  if (image.type() == CV_8UC3) return image;
  cv::Mat out;
  cv::cvtColor(grey_8bit(image), out, cv::COLOR_GRAY2BGR);
  return out;
}

cv::Mat features_picture(const PairInput& pair, const RefinedAlignment& result) {
  const int zoom = zoom_of(pair.image_1);
  cv::Mat panel = enlarged(colour_8bit(pair.image_1), zoom, cv::INTER_CUBIC) * 0.7;
  struct Mark {
    Eigen::Vector2d at, line_end;
    bool has_line;
    std::string status;
  };
  std::vector<Mark> marks;
  std::map<std::string, int> counts;
  double sum = 0;
  int lines = 0;
  for (int i = 0; i < pair.features.size(); ++i) {
    Mark mark;
    mark.status = feature_status(pair, result, i);
    ++counts[mark.status];
    if (!feature_position(pair, result, i, mark.at)) continue;
    mark.has_line = project_feature(pair.camera, pair.features, i, pair.truth.value_or(pair.T_10), mark.line_end);
    if (mark.has_line && (mark.status == "aligned" || mark.status == "projected"))
      sum += (mark.line_end - mark.at).norm(), ++lines;
    marks.push_back(std::move(mark));
  }
  const double mean = lines > 0 ? sum / lines : 0;
  // An error of a fraction of a pixel cannot be seen: it is drawn larger, and the legend says so.
  int magnified = 1;
  while (pair.truth && magnified < 100 && mean * zoom * magnified < 5) magnified *= 10;
  const auto pixel = [&](const Eigen::Vector2d& uv) {
    const Eigen::Vector2d p = ((uv + Eigen::Vector2d(0.5, 0.5)) * zoom * 16).cwiseMax(-1e6).cwiseMin(1e6);
    return cv::Point(static_cast<int>(std::lround(p.x())) - 8, static_cast<int>(std::lround(p.y())) - 8);
  };
  constexpr int kShift = 4;  // sub-pixel drawing
  for (const Mark& mark : marks) {
    cv::circle(panel, pixel(mark.at), 9 << kShift, {0, 0, 0}, 4, cv::LINE_AA, kShift);
    cv::circle(panel, pixel(mark.at), 9 << kShift, status_colour(mark.status), 2, cv::LINE_AA, kShift);
  }
  for (const Mark& mark : marks)
    if (mark.has_line)
      cv::line(panel, pixel(mark.at), pixel(mark.at + magnified * (mark.line_end - mark.at)), {60, 60, 255}, 2, cv::LINE_AA,
               kShift);
  cv::Mat canvas =
      framed(panel, "Features of the reference, found in the target (" + std::string(name(result.status)) + ")", 64);
  int x = 16;
  const int y = canvas.rows - 44;
  for (const auto& [status, count] : counts) {
    cv::circle(canvas, {x + 6, y - 5}, 7, status_colour(status), 2, cv::LINE_AA);
    const std::string words = format("%d %s", count, status.c_str());
    text(canvas, words, {x + 22, y});
    x += 22 + text_width(words) + 28;
  }
  cv::line(canvas, {16, canvas.rows - 19}, {44, canvas.rows - 19}, {60, 60, 255}, 2, cv::LINE_AA);
  const std::string legend = pair.truth
                                 ? format("from found to true position%s; mean distance %.2f px",
                                          magnified > 1 ? format(", drawn %d times as long", magnified).c_str() : "", mean)
                                 : format("back to where the first guess had it; mean distance %.1f px", mean);
  text(canvas, legend, {56, canvas.rows - 14});
  return canvas;
}

cv::Mat overlay_picture(const View& before, const View& after, const cv::Mat& grey_0, const std::string& depth_source) {
  const int zoom = zoom_of(grey_0);
  cv::Mat canvas = side_by_side(enlarged(overlay_panel(before, grey_0), zoom), enlarged(overlay_panel(after, grey_0), zoom),
                                "Before: target warped by the first guess", "After: target warped by the result", 40);
  const int y = canvas.rows - 14;
  int x = 16;
  const std::pair<const char*, cv::Scalar> entries[] = {{"only in the reference", {60, 60, 230}},
                                                        {"only in the target", {220, 220, 60}},
                                                        {"agree", {170, 170, 170}},
                                                        {"no depth, or not in the target", {70, 40, 40}}};
  for (const auto& [words, colour] : entries) {
    cv::rectangle(canvas, cv::Rect(x, y - 14, 18, 18), colour, cv::FILLED);
    text(canvas, words, {x + 26, y});
    x += 26 + text_width(words) + 26;
  }
  text(canvas, depth_source, {std::max(x, canvas.cols - 16 - text_width(depth_source)), y}, 0.62, kFaint);
  return canvas;
}

cv::Mat residual_picture(const View& before, const View& after, const cv::Mat& grey_0, const std::string& depth_source) {
  const int zoom = zoom_of(grey_0);
  const double range = std::isfinite(before.rms) ? std::clamp(std::ceil(before.rms / 5) * 10, 20.0, 120.0) : 60;
  cv::Mat canvas =
      side_by_side(enlarged(residual_panel(before, grey_0, range), zoom), enlarged(residual_panel(after, grey_0, range), zoom),
                   format("Before: residual of the first guess, RMS %.1f of 255", before.rms),
                   format("After: residual of the result, RMS %.1f of 255", after.rms), 44);
  const int y = canvas.rows - 14, bar = 300;
  const std::string low = format("target darker  -%.0f", range), high = format("+%.0f  target brighter", range);
  int x = 16;
  text(canvas, low, {x, y});
  x += text_width(low) + 12;
  for (int i = 0; i < bar; ++i)
    cv::line(canvas, {x + i, y - 16}, {x + i, y + 4}, cv::Scalar(signed_colour(2.0 * i / (bar - 1) - 1)));
  x += bar + 12;
  text(canvas, high, {x, y});
  x += text_width(high) + 30;
  cv::rectangle(canvas, cv::Rect(x, y - 14, 18, 18), {96, 96, 96}, cv::FILLED);
  text(canvas, "unknown", {x + 26, y});
  x += 26 + text_width("unknown") + 26;
  const std::string note = depth_source + "; exposure matched";
  text(canvas, note, {std::max(x, canvas.cols - 16 - text_width(note)), y}, 0.62, kFaint);
  return canvas;
}

}  // namespace

cv::Mat warp_target(const cv::Mat& grey_1, const cv::Mat& depth_0, const Camera& camera, const SE3& T_10) {
  cv::Mat map_u(depth_0.size(), CV_32FC1, cv::Scalar(-1)), map_v = map_u.clone(), known = cv::Mat::zeros(depth_0.size(), CV_8U);
  for (int v = 0; v < depth_0.rows; ++v)
    for (int u = 0; u < depth_0.cols; ++u) {
      const double z = depth_0.at<float>(v, u);
      if (!(z > 0)) continue;
      const Eigen::Vector3d X1 = T_10 * Eigen::Vector3d(z * camera.ray({u, v}));
      if (!(X1.z() > 0)) continue;
      const Eigen::Vector2d uv1 = camera.project(X1);
      if (!uv1.allFinite() || !camera.contains(uv1)) continue;
      map_u.at<float>(v, u) = static_cast<float>(uv1.x());
      map_v.at<float>(v, u) = static_cast<float>(uv1.y());
      known.at<uchar>(v, u) = 255;
    }
  cv::Mat grey, warped;
  grey_1.convertTo(grey, CV_32F);
  cv::remap(grey, warped, map_u, map_v, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  warped.setTo(NAN, known == 0);
  return warped;
}

cv::Mat picture_depth(const PairInput& pair) {
  if (!pair.depth_0.empty()) return pair.depth_0;
  const cv::Size size = pair.image_0.size();
  cv::Mat depth = cv::Mat::zeros(size, CV_32FC1);
  std::vector<cv::Point> at;
  std::vector<double> inverse;
  for (int i = 0; i < pair.features.size(); ++i) {
    const Eigen::Vector2d& uv = pair.features.uv[static_cast<size_t>(i)];
    const double q = pair.features.inverse_depth[static_cast<size_t>(i)];
    if (!uv.allFinite() || !pair.camera.contains(uv) || !std::isfinite(q) || q <= 0) continue;
    at.emplace_back(static_cast<int>(std::lround(uv.x())), static_cast<int>(std::lround(uv.y())));
    inverse.push_back(q);
  }
  if (at.size() < 3) return depth;
  // Inverse distance weights of the nearest features, on every fourth pixel; between these linear.
  constexpr int kStep = 4;
  constexpr size_t kNearest = 6;
  cv::Mat coarse(size.height / kStep + 2, size.width / kStep + 2, CV_32FC1);
  std::vector<std::pair<double, double>> near(at.size());
  for (int v = 0; v < coarse.rows; ++v)
    for (int u = 0; u < coarse.cols; ++u) {
      for (size_t i = 0; i < at.size(); ++i) near[i] = {std::hypot(u * kStep - at[i].x, v * kStep - at[i].y), inverse[i]};
      const size_t count = std::min(kNearest, near.size());
      std::partial_sort(near.begin(), near.begin() + static_cast<long>(count), near.end());
      double sum = 0, weights = 0;
      for (size_t i = 0; i < count; ++i) {
        const double w = 1 / (near[i].first * near[i].first + 1);
        sum += w * near[i].second, weights += w;
      }
      coarse.at<float>(v, u) = static_cast<float>(sum / weights);
    }
  std::vector<cv::Point> hull;
  cv::convexHull(at, hull);
  cv::Mat inside = cv::Mat::zeros(size, CV_8U);
  cv::fillConvexPoly(inside, hull, 255);
  for (int v = 0; v < size.height; ++v)
    for (int u = 0; u < size.width; ++u) {
      if (inside.at<uchar>(v, u) == 0) continue;
      const double x = static_cast<double>(u) / kStep, y = static_cast<double>(v) / kStep;
      const int x0 = std::min(static_cast<int>(x), coarse.cols - 2), y0 = std::min(static_cast<int>(y), coarse.rows - 2);
      const double a = x - x0, b = y - y0;
      const double q = (1 - b) * ((1 - a) * coarse.at<float>(y0, x0) + a * coarse.at<float>(y0, x0 + 1)) +
                       b * ((1 - a) * coarse.at<float>(y0 + 1, x0) + a * coarse.at<float>(y0 + 1, x0 + 1));
      depth.at<float>(v, u) = static_cast<float>(1 / q);
    }
  return depth;
}

std::vector<Picture> make_pictures(const PairInput& pair, const RefinedAlignment& result) {
  const cv::Mat grey_0 = grey_8bit(pair.image_0), grey_1 = grey_8bit(pair.image_1), depth = picture_depth(pair);
  const View before = view_by(pair, grey_0, grey_1, depth, pair.T_10),
             after = view_by(pair, grey_0, grey_1, depth, result.T_10);
  const std::string source = pair.depth_0.empty() ? "depth interpolated between the features" : "depth: the depth image";
  return {{"features.png", features_picture(pair, result)},
          {"overlay.png", overlay_picture(before, after, grey_0, source)},
          {"residual.png", residual_picture(before, after, grey_0, source)}};
}

}  // namespace iclk
