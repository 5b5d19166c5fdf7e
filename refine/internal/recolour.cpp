#include <iclk/refine/internal/recolour.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Cholesky>

#include <iclk/shaders/shared.h>

namespace iclk::internal {
namespace {

constexpr int kRounds = 8;           // of weights and gains; the weights settle to 1 % in three or four
constexpr int kLeastPatches = 8;     // three weights from fewer would overfit
constexpr double kLeastGain = 0.05;  // least reduction of the unexplained share
constexpr double kNoise = ICLK_LEAST_SIGMA;

/// A patch with given weights: w . C with the gain that fits T best.
struct Fit {
  double gain = 0;
  double rest = 0;  // sum of the squared residuals
};

Fit fit(const ColourSums& p, const Eigen::Vector3d& w) {
  const double square = w.dot(p.CC * w), product = std::max(0.0, w.dot(p.TC));  // a negative gain is a wrong place
  if (!(square > 0)) return {0, p.TT};
  return {product / square, std::max(0.0, p.TT - product * product / square)};
}

/// Cauchy weights of the patches by their unexplained shares, so that wrong matches do not determine the colours.
std::vector<double> patch_weights(std::span<const ColourSums* const> patches, const Eigen::Vector3d& w) {
  std::vector<double> rest;
  for (const ColourSums* p : patches) rest.push_back(std::sqrt(fit(*p, w).rest / (p->TT + ICLK_PATCH_AREA * kNoise * kNoise)));
  std::vector<double> sorted = rest;
  std::nth_element(sorted.begin(), sorted.begin() + sorted.size() / 2, sorted.end());
  const double scale = 2 * sorted[sorted.size() / 2] + 1e-6;
  for (double& r : rest) r = 1 / (1 + r * r / (scale * scale));
  return rest;
}

}  // namespace

Recolouring recolour(std::span<const ColourSums> all) {
  std::vector<const ColourSums*> patches;
  for (const ColourSums& p : all)
    if (std::isfinite(p.TT) && p.TC.allFinite() && p.CC.allFinite() && p.TT > 0 && p.CC.trace() > 0) patches.push_back(&p);
  if (patches.size() < kLeastPatches) return {};

  const Eigen::Vector3d luma(kLuma[0], kLuma[1], kLuma[2]);
  Eigen::Vector3d w = luma;
  std::vector<double> rho;
  for (int round = 0; round < kRounds; ++round) {
    rho = patch_weights(patches, w);
    Eigen::Matrix3d H = Eigen::Matrix3d::Zero();
    Eigen::Vector3d g = Eigen::Vector3d::Zero();
    double pixels = 0;  // weighted by the squared gains
    for (size_t i = 0; i < patches.size(); ++i) {
      const double gain = fit(*patches[i], w).gain;
      H += rho[i] * gain * gain * patches[i]->CC;
      g += rho[i] * gain * patches[i]->TC;
      pixels += rho[i] * gain * gain * ICLK_PATCH_AREA;
    }
    const double before = luma.dot(H * luma);
    if (!(before > 0)) return {};
    const Eigen::Matrix3d prior = kNoise * kNoise * pixels * Eigen::Matrix3d::Identity();
    w = luma + (H + prior).ldlt().solve(g - H * luma);
    const double after = w.dot(H * w);
    if (!w.allFinite() || !(after > 0)) return {};
    w *= std::sqrt(before / after);  // the patches have gains, so the weights keep the contrast of luma
  }
  double left = 0, left_by_luma = 0;
  for (size_t i = 0; i < patches.size(); ++i) {
    left += rho[i] * fit(*patches[i], w).rest;
    left_by_luma += rho[i] * fit(*patches[i], luma).rest;
  }
  if (!(left < (1 - kLeastGain) * left_by_luma)) return {};
  return {{static_cast<float>(w[0]), static_cast<float>(w[1]), static_cast<float>(w[2])}, left / left_by_luma};
}

}  // namespace iclk::internal
