#include <iclk/track/internal/epipolar_search.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <Eigen/LU>

#include <iclk/shaders/shared.h>
#include <iclk/track/internal/depth_filter.h>

namespace iclk::internal {
namespace {

constexpr double kStep = 1.5;               // px between two places of the line
constexpr int kMostSteps = 160;             // a longer line is not searched
constexpr double kLeastCorrelation = 0.85;  // of an accepted match
constexpr double kLeastLead = 0.05;         // of its correlation over that of all places that are not neighbours
constexpr double kNeighbourhood = 4;        // px
constexpr int kPatch = ICLK_PATCH, kArea = kPatch * kPatch;
constexpr double kCentre = 0.5 * (kPatch - 1);

/// Samples the patch around c, warped by A^-1, minus its mean and normalised to length 1. Returns false if it leaves the image,
/// is hidden or flat.
bool sample(const Map& map, const Eigen::Vector2d& c, const Eigen::Matrix2d& A_inverse, std::array<float, kArea>& out) {
  double sum = 0;
  for (int k = 0; k < kArea; ++k) {
    const Eigen::Vector2d p = c + A_inverse * Eigen::Vector2d(k % kPatch - kCentre, k / kPatch - kCentre);
    if (!(p.x() >= 0 && p.y() >= 0 && p.x() <= map.width - 1 && p.y() <= map.height - 1)) return false;
    const double value = map.bilinear(p.x(), p.y());
    if (!(value < kHiddenFrom)) return false;
    out[static_cast<size_t>(k)] = static_cast<float>(value);
    sum += value;
  }
  const auto mean = static_cast<float>(sum / kArea);
  float squares = 0;
  for (float& x : out) {
    x -= mean;
    squares += x * x;
  }
  if (!(squares > 0)) return false;
  const float scale = 1 / std::sqrt(squares);
  for (float& x : out) x *= scale;
  return true;
}

/// The step of the line from `from` to `from + line` at which the patch of image 0 correlates best. Nothing if no place or more
/// than one looks like it.
std::optional<int> best_step(const Map& f0, const Map& f1, const Eigen::Vector2d& uv0, const Eigen::Matrix2d& A_inverse,
                             const Eigen::Vector2d& from, const Eigen::Vector2d& line, int steps) {
  std::array<float, kArea> reference, patch;
  if (!sample(f0, uv0, A_inverse, reference)) return {};
  std::vector<double> score(static_cast<size_t>(steps) + 1, -1);
  for (int i = 0; i <= steps; ++i) {
    if (!sample(f1, from + line * i / steps, Eigen::Matrix2d::Identity(), patch)) continue;
    double correlation = 0;
    for (size_t k = 0; k < patch.size(); ++k) correlation += reference[k] * patch[k];
    score[static_cast<size_t>(i)] = correlation;
  }
  const auto best = static_cast<int>(std::max_element(score.begin(), score.end()) - score.begin());
  const double most = score[static_cast<size_t>(best)];
  // A place between two steps may have a higher correlation.
  if (most < kLeastCorrelation - 3 * kLeastLead) return {};
  for (int i = 0; i <= steps; ++i)
    if (std::abs(i - best) * line.norm() / steps > kNeighbourhood && score[static_cast<size_t>(i)] > most - kLeastLead)
      return {};
  return best;
}

}  // namespace

std::optional<AlignedFeature> search_epipolar(const Pyramid& f0, const Pyramid& f1, const Camera& camera,
                                              const Eigen::Vector2d& uv0, double low, double high, const SE3& T_10) {
  const PatchWarp near = warp_patch(camera, uv0, high, T_10), far = warp_patch(camera, uv0, low, T_10);
  const double middle_q = (low + high) / 2;
  const PatchWarp middle = warp_patch(camera, uv0, middle_q, T_10);
  if (!near.valid || !far.valid || !middle.valid) return {};
  const Eigen::Vector2d line = near.uv1 - far.uv1;
  const int steps = static_cast<int>(std::ceil(line.norm() / kStep));
  if (steps > kMostSteps) return {};
  double q = middle_q;
  if (steps > 2) {
    const auto best = best_step(f0[0], f1[0], uv0, middle.A.inverse(), far.uv1, line, steps);
    if (!best) return {};
    const Eigen::Vector3d ray1 = camera.ray(far.uv1 + line * static_cast<double>(*best) / steps);
    q = std::clamp(inverse_depth_at(T_10.R * camera.ray(uv0), T_10.t, ray1), low, high);
  }
  AlignedFeature found = align_feature(f0, f1, camera, uv0, q, T_10);
  if (found.status != FeatureStatus::aligned || found.correlation < kLeastCorrelation) return {};
  return found;
}

}  // namespace iclk::internal
