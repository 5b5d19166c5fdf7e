#include "apps/iclk/pictures/pictures.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include <opencv2/imgproc.hpp>

#include <iclk/session/feature_report.h>
#include <iclk/session/pose_errors.h>

#include "apps/iclk/pictures/drawing.h"
#include "apps/iclk/session/report.h"
#include "apps/json/format.h"

namespace iclk {
namespace {

/// Nobody should take the picture of a failure for that of a pose.
cv::Scalar verdict_colour(const RefinedAlignment& result) { return result.converged() ? kInk : kAlarm; }
std::string verdict(const RefinedAlignment& result) {
  return result.converged() ? "converged" : std::string("FAILED: ") + name(result.status);
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
struct PairView {
  cv::Mat warped;  ///< exposure matched, NaN = unknown
  double rms = NAN;
};

PairView view_by(const PairInput& pair, const cv::Mat& grey_0, const cv::Mat& grey_1, const cv::Mat& depth, const SE3& T_10) {
  PairView view{warp_target(grey_1, depth, pair.camera, T_10)};
  if (!pair.mask_1.empty())
    view.warped.setTo(std::numeric_limits<float>::quiet_NaN(), warp_target(pair.mask_1, depth, pair.camera, T_10) < 255);
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
cv::Mat overlay_panel(const PairView& view, const cv::Mat& grey_0) {
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

cv::Mat residual_panel(const PairView& view, const cv::Mat& grey_0, double range) {
  cv::Mat out(grey_0.size(), CV_8UC3, cv::Scalar(96, 96, 96));
  for (int v = 0; v < out.rows; ++v)
    for (int u = 0; u < out.cols; ++u)
      if (const float x = view.warped.at<float>(v, u); !std::isnan(x))
        out.at<cv::Vec3b>(v, u) = signed_colour((x - grey_0.at<uchar>(v, u)) / range);
  return out;
}

cv::Mat side_by_side(const cv::Mat& before, const cv::Mat& after, const Pen& pen, const std::string& title_0,
                     const std::string& title_1, const cv::Scalar& colour_1) {
  const int below = pen.px(42);
  const cv::Mat left = framed(before, pen, title_0, kInk, below), right = framed(after, pen, title_1, colour_1, below);
  cv::Mat out;
  cv::hconcat(std::vector<cv::Mat>{left, cv::Mat(left.rows, 8, CV_8UC3, kPaper), right}, out);
  return out;
}

cv::Scalar status_colour(const std::string& status) {
  static const std::map<std::string, cv::Scalar> colours = {{"aligned", {90, 230, 90}},
                                                            {"projected", {230, 200, 120}},
                                                            {"bad_match", {40, 160, 255}},
                                                            {"diverged", {255, 90, 230}},
                                                            {"low_texture", {255, 220, 60}}};
  const auto it = colours.find(status);
  return it == colours.end() ? cv::Scalar(150, 150, 150) : it->second;
}

cv::Mat features_picture(const PairInput& pair, const RefinedAlignment& result) {
  const int zoom = zoom_of(pair.image_1);
  const Pen pen(pair.image_1.cols * zoom);
  cv::Mat shown = colour_8bit(pair.image_1).clone();
  if (!pair.mask_1.empty()) shown.setTo(cv::Scalar(60, 40, 40), pair.mask_1 == 0);
  cv::Mat panel = enlarged(shown, zoom, cv::INTER_CUBIC) * 0.7;
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
    mark.status = feature_status(pair.camera, pair.features, result, i);
    ++counts[mark.status];
    if (!feature_position(pair.camera, pair.features, result, i, mark.at)) continue;
    mark.has_line = project_feature(pair.camera, pair.features, i, pair.truth.value_or(pair.start()), mark.line_end);
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
  const int radius = pen.px(std::clamp(9 * std::sqrt(400.0 / std::max(pair.features.size(), 1)), 3.0, 9.0));
  const int pencil = std::max(1, radius / 4);
  for (const Mark& mark : marks) {
    cv::circle(panel, pixel(mark.at), radius << kShift, {0, 0, 0}, 2 * pencil, cv::LINE_AA, kShift);
    cv::circle(panel, pixel(mark.at), radius << kShift, status_colour(mark.status), pencil, cv::LINE_AA, kShift);
  }
  const cv::Scalar red(60, 60, 255);
  // Thousands of lines would hide the image.
  const size_t stride = 1 + marks.size() / 500;
  for (size_t i = 0; i < marks.size(); i += stride)
    if (const Mark& mark = marks[i]; mark.has_line)
      cv::line(panel, pixel(mark.at), pixel(mark.at + magnified * (mark.line_end - mark.at)), red, pencil, cv::LINE_AA, kShift);
  cv::Mat canvas = framed(panel, pen, "Features of the reference, found in the target (" + verdict(result) + ")",
                          verdict_colour(result), pen.px(66));
  Legend rings{canvas, pen, canvas.rows - pen.px(44)};
  for (const auto& [status, count] : counts) rings.ring(status_colour(status), formatted("%d %s", count, status.c_str()));
  std::string line = pair.truth ? formatted("from found to true position%s; mean distance %.2f px",
                                            magnified > 1 ? formatted(", drawn %d times as long", magnified).c_str() : "", mean)
                                : formatted("from found position to that of the first guess; mean distance %.1f px", mean);
  if (stride > 1) line += formatted("; a line for one feature in %zu", stride);
  Legend{canvas, pen, canvas.rows - pen.px(14)}.line(red, line);
  return canvas;
}

cv::Mat overlay_picture(const PairView& before, const PairView& after, const cv::Mat& grey_0, const RefinedAlignment& result,
                        const std::string& depth_source) {
  const int zoom = zoom_of(grey_0);
  const Pen pen(static_cast<int>(1.4 * grey_0.cols * zoom));
  cv::Mat canvas = side_by_side(enlarged(overlay_panel(before, grey_0), zoom), enlarged(overlay_panel(after, grey_0), zoom),
                                pen, "Before: target warped by the first guess",
                                "After: target warped by the result (" + verdict(result) + ")", verdict_colour(result));
  Legend legend{canvas, pen, canvas.rows - pen.px(14)};
  legend.square({60, 60, 230}, "only in the reference");
  legend.square({220, 220, 60}, "only in the target");
  legend.square({170, 170, 170}, "agree");
  legend.square({70, 40, 40}, "no depth, or not in the target");
  legend.note(depth_source);
  return canvas;
}

cv::Mat residual_picture(const PairView& before, const PairView& after, const cv::Mat& grey_0, const RefinedAlignment& result,
                         const std::string& depth_source) {
  const int zoom = zoom_of(grey_0);
  const Pen pen(static_cast<int>(1.4 * grey_0.cols * zoom));
  const double range = std::isfinite(before.rms) ? std::clamp(std::ceil(before.rms / 5) * 10, 20.0, 120.0) : 60;
  const auto rms = [](const PairView& view) {
    return std::isfinite(view.rms) ? formatted("RMS %.1f of 255 grey levels", view.rms) : std::string("nothing to compare");
  };
  cv::Mat canvas = side_by_side(
      enlarged(residual_panel(before, grey_0, range), zoom), enlarged(residual_panel(after, grey_0, range), zoom), pen,
      "Before: target minus reference, " + rms(before),
      "After" + (result.converged() ? std::string() : " (" + verdict(result) + ")") + ": target minus reference, " + rms(after),
      verdict_colour(result));
  Legend legend{canvas, pen, canvas.rows - pen.px(14)};
  legend.words(formatted("target darker  -%.0f", range), 12);
  const int bar = pen.px(300);
  for (int i = 0; i < bar; ++i)
    cv::line(canvas, {legend.x + i, legend.y - pen.px(16)}, {legend.x + i, legend.y + pen.px(4)},
             cv::Scalar(signed_colour(2.0 * i / (bar - 1) - 1)));
  legend.x += bar + pen.px(12);
  legend.words(formatted("+%.0f  target brighter", range), 30);
  legend.square({96, 96, 96}, "unknown");
  legend.note(depth_source + "; exposure matched");
  return canvas;
}

}  // namespace

cv::Mat overlay_image(const PairInput& pair, const cv::Mat& depth_0, const SE3& T_10) {
  const cv::Mat grey_0 = grey_8bit(pair.image_0);
  return overlay_panel(view_by(pair, grey_0, grey_8bit(pair.image_1), depth_0, T_10), grey_0);
}

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
  const PairView before = view_by(pair, grey_0, grey_1, depth, pair.start()),
                 after = view_by(pair, grey_0, grey_1, depth, result.T_10);
  const std::string source = pair.depth_0.empty() ? "warped by depth between features" : "warped by the depth image";
  return {{"features.png", features_picture(pair, result)},
          {"overlay.png", overlay_picture(before, after, grey_0, result, source)},
          {"residual.png", residual_picture(before, after, grey_0, result, source)}};
}

}  // namespace iclk
