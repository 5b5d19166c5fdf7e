#include "apps/iclk/io/levels.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace iclk {
namespace {

constexpr int kWhite = 65535;
constexpr int kFullRange = 16384, kLeastRange = 1024;  // of values; noise alone is not to fill the range
constexpr double kOutliers = 1e-3;                     // of the pixels, at either end
constexpr double kMargin = 0.25;                       // of the range, for brighter and darker images that follow

}  // namespace

Levels::Levels(std::initializer_list<cv::Mat> images) : Levels(std::vector<cv::Mat>(images)) {}

Levels::Levels(const std::vector<cv::Mat>& images) {
  std::vector<size_t> counts(kWhite + 1);
  size_t total = 0;
  for (const cv::Mat& image : images) {
    if (image.depth() != CV_16U) continue;
    const int columns = image.cols * image.channels();
    for (int v = 0; v < image.rows; ++v)
      for (int u = 0; u < columns; ++u) ++counts[image.ptr<uint16_t>(v)[u]];
    total += static_cast<size_t>(columns) * static_cast<size_t>(image.rows);
  }
  if (total == 0) return;
  const auto most = static_cast<size_t>(kOutliers * static_cast<double>(total));
  int low = 0, high = kWhite;
  for (size_t below = counts[0]; below <= most;) below += counts[static_cast<size_t>(++low)];
  for (size_t above = counts[kWhite]; above <= most;) above += counts[static_cast<size_t>(--high)];
  if (high - low >= kFullRange) return;
  const double range = std::max(high - low, kLeastRange), middle = 0.5 * (low + high);
  const double scale = kWhite / ((1 + 2 * kMargin) * range);
  table_.create(1, kWhite + 1, CV_16UC1);
  for (int i = 0; i <= kWhite; ++i)
    table_.at<uint16_t>(i) =
        static_cast<uint16_t>(std::lrint(std::clamp(0.5 * kWhite + scale * (i - middle), 0.0, 1.0 * kWhite)));
}

void Levels::apply(cv::Mat& image) const {
  if (table_.empty() || image.depth() != CV_16U) return;
  const int columns = image.cols * image.channels();
  for (int v = 0; v < image.rows; ++v) {
    auto* const row = image.ptr<uint16_t>(v);
    std::transform(row, row + columns, row, [&](uint16_t x) { return table_.at<uint16_t>(x); });
  }
}

}  // namespace iclk
