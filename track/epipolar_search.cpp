#include <iclk/track/epipolar_search.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <Eigen/LU>

#include <iclk/refine/internal/align_feature.h>
#include <iclk/shaders/shared.h>

namespace iclk {
namespace {

constexpr int kPatch = ICLK_PATCH, kArea = kPatch * kPatch;
constexpr double kCentre = 0.5 * (kPatch - 1);

/// The patch about c, warped by A^-1, without its mean and of length 1. False where it leaves the image, is hidden or flat.
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

}  // namespace

std::optional<AlignedFeature> search_epipolar(const Pyramid& f0, const Pyramid& f1, const Camera& camera,
                                              const Eigen::Vector2d& uv0, double low, double high, const SE3& T_10,
                                              const EpipolarSearchOptions& options, const FeatureAlignmentOptions& alignment) {
  const internal::PatchWarp near = internal::warp_patch(camera, uv0, high, T_10),
                            far = internal::warp_patch(camera, uv0, low, T_10);
  const double middle_q = (low + high) / 2;
  const internal::PatchWarp middle = internal::warp_patch(camera, uv0, middle_q, T_10);
  if (!near.valid || !far.valid || !middle.valid) return {};
  const Eigen::Vector2d line = near.uv1 - far.uv1;
  const int steps = static_cast<int>(std::ceil(line.norm() / options.step));
  if (steps > options.max_steps) return {};
  double q = middle_q;
  if (steps > 2) {
    std::array<float, kArea> reference, patch;
    if (!sample(f0[0], uv0, middle.A.inverse(), reference)) return {};
    std::vector<double> score(static_cast<size_t>(steps) + 1, -1);
    for (int i = 0; i <= steps; ++i) {
      if (!sample(f1[0], far.uv1 + line * i / steps, Eigen::Matrix2d::Identity(), patch)) continue;
      double correlation = 0;
      for (size_t k = 0; k < patch.size(); ++k) correlation += reference[k] * patch[k];
      score[static_cast<size_t>(i)] = correlation;
    }
    const auto best = std::max_element(score.begin(), score.end()) - score.begin();
    // A place between two steps is less alike than it will be.
    if (score[static_cast<size_t>(best)] < options.min_correlation - 3 * options.min_lead) return {};
    for (int i = 0; i <= steps; ++i)
      if (std::abs(i - best) * line.norm() / steps > options.neighbourhood &&
          score[static_cast<size_t>(i)] > score[static_cast<size_t>(best)] - options.min_lead)
        return {};
    // The inverse depth at that place: projective along the line.
    const Eigen::Vector3d r = T_10.R * camera.ray(uv0), &t = T_10.t;
    const Eigen::Vector3d ray1 = camera.ray(far.uv1 + line * static_cast<double>(best) / steps);
    const Eigen::Vector2d rest(r.x() - ray1.x() * r.z(), r.y() - ray1.y() * r.z());
    const Eigen::Vector2d slope(t.x() - ray1.x() * t.z(), t.y() - ray1.y() * t.z());
    q = std::clamp(-rest.dot(slope) / slope.squaredNorm(), low, high);
  }
  AlignedFeature found = internal::align_feature(f0, f1, camera, uv0, q, T_10, alignment);
  if (found.status != FeatureStatus::aligned || found.correlation < options.min_correlation) return {};
  return found;
}

}  // namespace iclk
