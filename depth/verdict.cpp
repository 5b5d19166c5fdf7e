#include <algorithm>
#include <cmath>
#include <string>

#include <iclk/depth/depth_sweep.h>
#include <iclk/depth/internal/verdict.h>

namespace iclk {
namespace {

// The mean confidence of the pixels that the views see. Right inputs have 0.14 to 0.6, 78 of 84 wrong ones less than this limit
// (docs/results/depth.md).
constexpr double kLeastConfidence = 0.1;
constexpr double kLeastSeen = 0.05;
constexpr double kLeastAgreeing = 0.5;
constexpr int kLeastCompared = 8;
// The relative error of a sparse depth.
constexpr double kRelative = 0.05;

std::string percent(double share) { return std::to_string(std::lround(100 * share)) + " %"; }

// The map around a sparse depth.
struct Around {
  int answers = 0, near = 0;
  bool agrees() const { return 3 * near >= answers; }
};

Around around(const DepthMap& map, const Eigen::Vector2d& uv, double w, double tolerance) {
  constexpr int kRadius = 3;
  Around out;
  const int u = static_cast<int>(std::lround(uv.x())), v = static_cast<int>(std::lround(uv.y()));
  for (int b = -kRadius; b <= kRadius; ++b)
    for (int a = -kRadius; a <= kRadius; ++a) {
      // If it is a prior, paths spread it along its row, its column and its diagonals.
      if (a == 0 || b == 0 || std::abs(a) == std::abs(b)) continue;
      const int x = u + a, y = v + b;
      if (x < 0 || y < 0 || x >= map.inverse_depth.width || y >= map.inverse_depth.height) continue;
      const auto answer = static_cast<double>(map.inverse_depth.at(x, y));
      if (!(answer > 0)) continue;
      ++out.answers;
      out.near += std::abs(answer - w) <= tolerance;
    }
  return out;
}

}  // namespace

void compare(DepthMap& map, const Features& sparse, double tolerance) {
  int compared = 0, agreeing = 0;
  for (size_t i = 0; i < sparse.uv.size(); ++i) {
    const double w = sparse.inverse_depth[i];
    const Eigen::Vector2d& uv = sparse.uv[i];
    const bool inside = uv.x() >= 0 && uv.y() >= 0 && uv.x() < map.inverse_depth.width && uv.y() < map.inverse_depth.height;
    if (!inside || !(w > 0 && std::isfinite(w))) continue;
    const Around near = around(map, uv, w, std::max(tolerance, kRelative * w));
    if (near.answers == 0) continue;
    ++compared, agreeing += near.agrees();
  }
  if (compared < kLeastCompared) return;
  map.agreeing = static_cast<double>(agreeing) / compared;
  const std::string told = std::to_string(agreeing) + " of " + std::to_string(compared) + " sparse depths agree with the map";
  if (map.status != Status::converged) return;
  map.reason += ", " + told;
  if (map.agreeing >= kLeastAgreeing) return;
  map.status = Status::diverged;
  map.reason = "only " + told + ": check the poses, their unit and the depths";
}

void internal::judge(DepthMap& map) {
  double sum = 0;
  for (const float c : map.confidence.data) sum += static_cast<double>(c);
  const double confidence = sum / static_cast<double>(map.confidence.data.size()) / std::max(map.seen, 1e-9);
  const std::string answered = percent(map.valid) + " of the pixels have a depth; the views see " + percent(map.seen);
  if (map.seen < kLeastSeen) {
    map.status = Status::low_overlap;
    map.reason = "the views see " + percent(map.seen) + " of the reference at these depths: check the poses and the range";
  } else if (confidence < kLeastConfidence) {
    map.status = Status::degenerate;
    map.reason = answered + "; matches are hardly better than chance: check the poses and the range, and that there is texture";
  } else {
    map.status = Status::converged;
    map.reason = answered;
  }
}

}  // namespace iclk
