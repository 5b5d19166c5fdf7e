#include "apps/iclk/depth/figures.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <fmt/format.h>

namespace iclk {

DepthFigures depth_figures(const cv::Mat& depth, const cv::Mat& truth, const Camera& camera, std::span<const Camera> views,
                           std::span<const SE3> T_10) {
  DepthFigures out;
  std::vector<double> errors;
  int beyond_1 = 0, beyond_2 = 0, seen = 0, seen_answered = 0;
  for (int v = 0; v < truth.rows; ++v)
    for (int u = 0; u < truth.cols; ++u) {
      const double z = static_cast<double>(truth.at<float>(v, u)), answer = static_cast<double>(depth.at<float>(v, u));
      if (!(z > 0)) continue;
      ++out.known;
      const Eigen::Vector3d X = camera.ray({u, v}) * z;
      bool in_view = false;
      for (size_t i = 0; i < views.size(); ++i) {
        const Eigen::Vector3d there = T_10[i] * X;
        in_view = in_view || (there.z() > 0 && views[i].contains(views[i].project(there)));
      }
      seen += in_view, seen_answered += in_view && answer > 0;
      if (!(answer > 0)) continue;
      errors.push_back(std::abs(answer - z) / z);
      const Eigen::Vector3d a = T_10[0] * X, b = T_10[0] * (X * (answer / z));
      const double off = a.z() > 0 && b.z() > 0 ? (views[0].project(a) - views[0].project(b)).norm() : INFINITY;
      beyond_1 += off > 1, beyond_2 += off > 2;
    }
  if (out.known == 0) return out;
  const auto answers = static_cast<double>(errors.size()), known = static_cast<double>(out.known);
  out.completeness = answers / known;
  out.seen = seen / known;
  out.seen_answered = seen > 0 ? static_cast<double>(seen_answered) / seen : 0;
  out.bad_1 = (known - answers + beyond_1) / known;
  out.bad_2 = (known - answers + beyond_2) / known;
  if (errors.empty()) return out;
  out.bad_2_of_answers = beyond_2 / answers;
  std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2), errors.end());
  out.median_error = errors[errors.size() / 2];
  return out;
}

std::string to_text(const DepthFigures& f) {
  return fmt::format(
      "bad-2.0 {:.2f} % (of the answers {:.2f} %), bad-1.0 {:.2f} %, median error {:.3f} %, complete {:.1f} % (of what a view "
      "sees {:.1f} %)",
      100 * f.bad_2, 100 * f.bad_2_of_answers, 100 * f.bad_1, 100 * f.median_error, 100 * f.completeness,
      100 * f.seen_answered);
}

}  // namespace iclk
