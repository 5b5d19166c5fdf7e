#include <iclk/depth/depth_options.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <iclk/align/common/options_check.h>
#include <iclk/align/common/text.h>
#include <iclk/engine/error.h>
#include <iclk/shaders/depth/depth.h>

namespace iclk {
namespace {

constexpr int kMostRounds = 60000;

[[noreturn]] void fail(const std::string& why) { throw Error(ErrorCode::invalid_argument, "depth: " + why); }

}  // namespace

void DepthPlan::check() const {
  check_range("depth: width", width, 16, 16384);
  check_range("depth: height", height, 16, 16384);
  check_range("depth: planes", planes, ICLK_DEPTH_QUAD, ICLK_DEPTH_PLANES);
  check_range("depth: views", views, 1, ICLK_DEPTH_VIEWS);
  if (planes % ICLK_DEPTH_QUAD != 0)
    fail(std::to_string(planes) + " planes: must be a multiple of " + std::to_string(ICLK_DEPTH_QUAD));
  if (std::max(width, height) * (planes / ICLK_DEPTH_QUAD) > kMostRounds)
    fail("images of " + std::to_string(width) + "x" + std::to_string(height) + " allow " +
         std::to_string(kMostRounds / std::max(width, height) * ICLK_DEPTH_QUAD) + " planes at most, not " +
         std::to_string(planes) + "; use fewer planes or smaller images");
}

void DepthOptions::check() const {
  check_range("depth: p1", p1, 1, ICLK_DEPTH_MAX_P2 - 1);
  check_range("depth: p2", p2, p1 + 1, ICLK_DEPTH_MAX_P2);
  check_range("depth: edge", edge, 0, 255);
  check_range("depth: uniqueness", uniqueness, 0, 1);
  check_range("depth: tolerance", tolerance, 0, ICLK_DEPTH_PLANES);
  check_range("depth: iterations", iterations, 0, 20);
  check_range("depth: speckle", speckle, 0, 1 << 28);
  check_range("depth: speckle_step", speckle_step, 0, ICLK_DEPTH_PLANES);
}

void DepthRange::check() const {
  if (!(near > 0 && std::isfinite(near) && far > near))
    fail("a range of depth from " + internal::text_of(near) + " to " + internal::text_of(far) +
         " m: near must be above 0, and far above near");
}

int planes_for(const Camera& reference, std::span<const Camera> cameras, std::span<const SE3> T_10, const DepthRange& range,
               double pixels) {
  constexpr int kGrid = 4, kSteps = 64;
  const double first = 1 / range.far, step = (1 / range.near - first) / kSteps;
  double most = 0;
  for (size_t view = 0; view < cameras.size(); ++view)
    for (int j = 0; j <= kGrid; ++j)
      for (int i = 0; i <= kGrid; ++i) {
        const Eigen::Vector3d ray = reference.ray({(reference.width - 1.0) * i / kGrid, (reference.height - 1.0) * j / kGrid});
        const Eigen::Vector3d turned = T_10[view].R * ray;
        for (int s = 0; s < kSteps; ++s) {
          const Eigen::Vector3d a = turned + (first + step * s) * T_10[view].t, b = a + step * T_10[view].t;
          if (a.z() <= 0 || b.z() <= 0) continue;
          const Eigen::Vector2d from = cameras[view].project(a), to = cameras[view].project(b);
          if (cameras[view].contains(from) && cameras[view].contains(to)) most = std::max(most, (to - from).norm() * kSteps);
        }
      }
  const double wanted = std::clamp(std::ceil(most / pixels) + 1, 1.0, double{ICLK_DEPTH_PLANES});
  return (static_cast<int>(wanted) + ICLK_DEPTH_QUAD - 1) / ICLK_DEPTH_QUAD * ICLK_DEPTH_QUAD;
}

DepthRange range_of(std::span<const double> inverse_depths, double margin) {
  std::vector<double> w;
  for (const double value : inverse_depths)
    if (std::isfinite(value) && value > 0) w.push_back(value);
  if (w.empty()) fail("the depth range is unknown: give near and far, or sparse depths");
  std::sort(w.begin(), w.end());
  const size_t cut = w.size() / 100;
  const double low = w[cut] / (1 + margin), high = w[w.size() - 1 - cut] * (1 + margin);
  return {1 / high, 1 / low};
}

}  // namespace iclk
