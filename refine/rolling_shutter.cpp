#include <iclk/refine/rolling_shutter.h>

#include <algorithm>

namespace iclk {
namespace {

constexpr int kCell = 16;  // px between the nodes of a grid: between them, lenses bend rows by less than a hundredth of a row

}  // namespace

RowTimes::RowTimes(const Camera& camera) : camera_(camera) {}

RowTimes::RowTimes(const Camera& camera, const std::function<double(const Eigen::Vector2d&)>& time)
    : camera_(camera), columns_((camera.width - 1) / kCell + 2) {
  const int rows = (camera.height - 1) / kCell + 2;
  nodes_.reserve(static_cast<size_t>(columns_) * static_cast<size_t>(rows));
  for (int j = 0; j < rows; ++j)
    for (int i = 0; i < columns_; ++i) nodes_.push_back(time(Eigen::Vector2d(i, j) * kCell));
}

double RowTimes::at(const Eigen::Vector2d& uv) const {
  if (nodes_.empty()) return row_time(camera_, uv.y());
  // NaN becomes the first pixel.
  const double x = std::max(0.0, std::min(uv.x(), camera_.width - 1.0)) / kCell;
  const double y = std::max(0.0, std::min(uv.y(), camera_.height - 1.0)) / kCell;
  const auto i = static_cast<size_t>(x), j = static_cast<size_t>(y);
  const double a = x - static_cast<double>(i), b = y - static_cast<double>(j);
  const double* above = &nodes_[j * static_cast<size_t>(columns_) + i];
  const double* below = above + columns_;
  return (1 - b) * ((1 - a) * above[0] + a * above[1]) + b * ((1 - a) * below[0] + a * below[1]);
}

}  // namespace iclk
