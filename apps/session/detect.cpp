#include "apps/session/detect.h"

#include <algorithm>
#include <cmath>
#include <random>

#include <opencv2/imgproc.hpp>

#include <iclk/engine/error.h>
#include <iclk/shaders/shared.h>

#include "apps/io/text.h"

namespace iclk {
namespace {

constexpr double kMaxDepthSpread =
    0.05;  // of the patch's depth; a floor seen at 70 degrees spreads by 4 % over 8 px at f = 500
// Smaller eigenvalue of the mean gradient matrix, (grey / px)^2, grey in [0, 1]: texture well above the noise of an 8-bit
// camera.
constexpr double kTexture = 1e-4;
constexpr double kResponse = 4;  // what cv::cornerMinEigenVal gives for a texture of 1, block 7, Sobel 3
constexpr int kMinDistance = 8;  // px: a patch; less in images of fewer than 64 px

/// 255 at pixels that may carry a feature.
struct Candidates {
  cv::Mat smooth;  ///< the whole patch is seen and has one depth
  cv::Mat any;     ///< seen, with depth
};

Candidates find_candidates(const cv::Mat& depth, const cv::Mat& seen, int border) {
  const cv::Mat patch = cv::Mat::ones(ICLK_PATCH, ICLK_PATCH, CV_8U);
  const cv::Point first(ICLK_PATCH_BEFORE, ICLK_PATCH_BEFORE);
  cv::Mat low, high;
  cv::erode(depth, low, patch, first, 1, cv::BORDER_REPLICATE);  // 0 where any pixel of the patch has no depth
  cv::dilate(depth, high, patch, first, 1, cv::BORDER_REPLICATE);
  Candidates c{(low > 0) & (high - low <= kMaxDepthSpread * depth), depth > 0};
  if (!seen.empty()) {
    cv::Mat patch_seen;
    cv::erode(seen, patch_seen, patch, first, 1, cv::BORDER_REPLICATE);
    c.smooth &= patch_seen;
    c.any &= patch_seen;
  }
  cv::Mat inside = cv::Mat::zeros(depth.size(), CV_8U);
  const cv::Rect room(border, border, depth.cols - 2 * border, depth.rows - 2 * border);
  if (room.width > 0 && room.height > 0) inside(room).setTo(255);
  c.smooth &= inside;
  c.any &= inside;
  return c;
}

/// Features on a map of occupied places, so that no two lie closer than `distance`.
struct Picker {
  const cv::Mat& depth;
  Features features;
  const int distance;
  cv::Mat free;

  explicit Picker(const cv::Mat& d)
      : depth(d), distance(std::clamp(std::min(d.cols, d.rows) / 8, 1, kMinDistance)), free(d.size(), CV_8U, cv::Scalar(255)) {}

  void take(const cv::Point& p) {
    features.uv.emplace_back(p.x, p.y);
    features.inverse_depth.push_back(1.0 / depth.at<float>(p));
    cv::circle(free, p, distance - 1, 0, cv::FILLED);
  }
};

/// Cells of the image, `count` in all, row by row, nearly square.
std::vector<cv::Rect> cells(const cv::Size& size, int count, int border) {
  const int width = size.width - 2 * border, height = size.height - 2 * border;
  std::vector<cv::Rect> out;
  if (width <= 0 || height <= 0) return out;
  const int rows = std::clamp(static_cast<int>(std::lround(std::sqrt(static_cast<double>(count) * height / width))), 1, count);
  for (int r = 0; r < rows; ++r) {
    const int columns =
        static_cast<int>((static_cast<int64_t>(count) * (r + 1)) / rows - (static_cast<int64_t>(count) * r) / rows);
    const int y0 = static_cast<int>(static_cast<int64_t>(height) * r / rows),
              y1 = static_cast<int>(static_cast<int64_t>(height) * (r + 1) / rows);
    for (int c = 0; c < columns; ++c) {
      const int x0 = static_cast<int>(static_cast<int64_t>(width) * c / columns),
                x1 = static_cast<int>(static_cast<int64_t>(width) * (c + 1) / columns);
      if (x1 > x0 && y1 > y0) out.emplace_back(border + x0, border + y0, x1 - x0, y1 - y0);
    }
  }
  return out;
}

void pick_corners(const cv::Mat& grey, const Candidates& candidates, const DetectorOptions& options, Picker& picker) {
  cv::Mat response;
  cv::cornerMinEigenVal(grey, response, 7, 3);
  const std::vector<cv::Rect> buckets = cells(grey.size(), options.count, options.border);
  // Good corners on smooth depth first, one a bucket and round; then weaker ones; then depth edges.
  const struct {
    const cv::Mat& where;
    double threshold;
  } tiers[] = {{candidates.smooth, kResponse * kTexture}, {candidates.smooth, 0}, {candidates.any, 0}};
  for (const auto& tier : tiers) {
    const cv::Mat strong = (response > tier.threshold) & tier.where;
    for (bool found = true; found && picker.features.size() < options.count;) {
      struct Corner {
        double response;
        cv::Point at;
      };
      std::vector<Corner> round;
      for (const cv::Rect& bucket : buckets) {
        const cv::Mat mask = strong(bucket) & picker.free(bucket);
        double value = 0;
        cv::Point at;
        cv::minMaxLoc(response(bucket), nullptr, &value, nullptr, &at, mask);
        if (value > 0) round.push_back({value, at + bucket.tl()});
      }
      std::stable_sort(round.begin(), round.end(), [](const Corner& a, const Corner& b) { return a.response > b.response; });
      found = false;
      for (const Corner& corner : round) {
        if (picker.features.size() == options.count) break;
        if (picker.free.at<uchar>(corner.at) == 0) continue;
        picker.take(corner.at);
        found = true;
      }
    }
  }
}

/// The candidate nearest to each cell's centre, within the cell.
void pick_grid(const Candidates& candidates, const DetectorOptions& options, Picker& picker) {
  for (const cv::Rect& cell : cells(candidates.any.size(), options.count, options.border)) {
    const cv::Point centre = (cell.tl() + cell.br()) / 2;
    cv::Point best;
    int distance = INT32_MAX;
    for (const cv::Mat* where : {&candidates.smooth, &candidates.any}) {
      for (int v = cell.y; v < cell.y + cell.height; ++v)
        for (int u = cell.x; u < cell.x + cell.width; ++u) {
          const int d = (u - centre.x) * (u - centre.x) + (v - centre.y) * (v - centre.y);
          if (d < distance && where->at<uchar>(v, u) != 0) distance = d, best = {u, v};
        }
      if (distance != INT32_MAX) break;
    }
    if (distance != INT32_MAX) picker.take(best);
  }
}

void pick_random(const Candidates& candidates, const DetectorOptions& options, Picker& picker) {
  std::mt19937_64 random(options.seed);
  cv::Mat edges = candidates.any & ~candidates.smooth;
  for (const cv::Mat& where : {candidates.smooth, edges}) {
    std::vector<cv::Point> places;
    cv::findNonZero(where, places);
    // Partial Fisher-Yates. The standard distributions differ between libraries; a remainder does not.
    for (size_t i = 0; i < places.size() && picker.features.size() < options.count; ++i) {
      std::swap(places[i], places[i + random() % (places.size() - i)]);
      picker.take(places[i]);
    }
  }
}

}  // namespace

void DetectorOptions::check() const {
  const auto fail = [](const std::string& why) -> void { throw Error(ErrorCode::invalid_argument, why); };
  if (count < 1 || count > 100000) fail("feature count " + std::to_string(count) + " must lie in 1 to 100000");
  if (border < 0) fail("border " + std::to_string(border) + " must not be negative");
}

Detector parse_detector(const std::string& name) {
  if (name == "shi-tomasi") return Detector::shi_tomasi;
  if (name == "grid") return Detector::grid;
  if (name == "random") return Detector::random;
  throw Error(ErrorCode::invalid_argument, "detector '" + printable(name) + "' is not known: shi-tomasi, grid or random");
}

cv::Mat grey_8bit(const cv::Mat& image) {
  cv::Mat grey = image;
  if (image.channels() == 3) cv::cvtColor(image, grey, image.depth() == CV_32F ? cv::COLOR_RGB2GRAY : cv::COLOR_BGR2GRAY);
  if (grey.depth() == CV_8U) return grey;
  double low = 0, high = 0;
  cv::minMaxLoc(grey, &low, &high);
  const double scale = high > low ? 255 / (high - low) : 0;
  cv::Mat out;
  grey.convertTo(out, CV_8U, scale, -low * scale);
  return out;
}

Features detect_features(const cv::Mat& image, const cv::Mat& depth, const cv::Mat& seen, const DetectorOptions& wanted) {
  wanted.check();
  if (depth.size() != image.size() || depth.type() != CV_32FC1 || (!seen.empty() && seen.size() != image.size()))
    throw Error(ErrorCode::invalid_argument, "depth of " + std::to_string(depth.cols) + "x" + std::to_string(depth.rows) +
                                                 " for an image of " + std::to_string(image.cols) + "x" +
                                                 std::to_string(image.rows));
  DetectorOptions options = wanted;
  options.border = std::min(options.border, std::min(image.cols, image.rows) / 4);
  const Candidates candidates = find_candidates(depth, seen, options.border);
  Picker picker(depth);
  switch (options.detector) {
    case Detector::shi_tomasi: pick_corners(grey_8bit(image), candidates, options, picker); break;
    case Detector::grid: pick_grid(candidates, options, picker); break;
    case Detector::random: pick_random(candidates, options, picker); break;
  }
  if (picker.features.size() == 0) pick_grid(candidates, options, picker);
  return std::move(picker.features);
}

}  // namespace iclk
