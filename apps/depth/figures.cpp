#include "apps/depth/figures.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <fmt/format.h>

namespace iclk {

DepthFigures depth_figures(const cv::Mat& depth, const cv::Mat& truth, const Camera& camera, const Camera& view,
                           const SE3& T_10) {
  DepthFigures out;
  std::vector<double> errors;
  int beyond_1 = 0, beyond_2 = 0;
  for (int v = 0; v < truth.rows; ++v)
    for (int u = 0; u < truth.cols; ++u) {
      const double z = static_cast<double>(truth.at<float>(v, u)), answer = static_cast<double>(depth.at<float>(v, u));
      if (!(z > 0)) continue;
      ++out.known;
      if (!(answer > 0)) continue;
      errors.push_back(std::abs(answer - z) / z);
      const Eigen::Vector3d ray = camera.ray({u, v}), a = T_10 * (ray * z), b = T_10 * (ray * answer);
      const double off = a.z() > 0 && b.z() > 0 ? (view.project(a) - view.project(b)).norm() : INFINITY;
      beyond_1 += off > 1, beyond_2 += off > 2;
    }
  if (out.known == 0) return out;
  const auto answers = static_cast<double>(errors.size()), known = static_cast<double>(out.known);
  out.completeness = answers / known;
  out.bad_1 = (known - answers + beyond_1) / known;
  out.bad_2 = (known - answers + beyond_2) / known;
  if (errors.empty()) return out;
  out.bad_2_of_answers = beyond_2 / answers;
  std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2), errors.end());
  out.median_error = errors[errors.size() / 2];
  return out;
}

std::string to_text(const DepthFigures& f) {
  return fmt::format("bad-2.0 {:.2f} % (of the answers {:.2f} %), bad-1.0 {:.2f} %, median error {:.3f} %, complete {:.1f} %",
                     100 * f.bad_2, 100 * f.bad_2_of_answers, 100 * f.bad_1, 100 * f.median_error, 100 * f.completeness);
}

}  // namespace iclk
