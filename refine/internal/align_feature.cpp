#include <iclk/refine/internal/align_feature.h>

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/LU>

#include <iclk/engine/error.h>
#include <iclk/shaders/shared.h>

namespace iclk::internal {
namespace {

constexpr int kPatch = ICLK_PATCH, kArea = ICLK_PATCH_AREA;
constexpr int kSupport = kPatch + 2;  // the template with a ring for its central differences
constexpr double kCentre =
    0.5 * (kPatch - 1);  // offsets -3.5 .. 3.5: a wrong warp then rotates the patch around the feature without moving it

/// The warped patch of one level and the data that all iterations share.
struct Template {
  bool inside = false;                  // the patch lies in image 0
  std::array<double, kArea> T, Tu, Tv;  // T minus its mean; gradients in px of the level in image 1
  double mean = 0;
  double STT = 0;     // sum T^2
  Eigen::Matrix2d B;  // columns: sum grad T * T, sum grad T
  Eigen::Matrix2d S;  // Schur complement of (du, dv) in the 4x4 normal matrix
  Eigen::Matrix2d S_inverse;
  double noise = 1;    // variance of interpolated over variance of raw white noise, mean over the patch
  double texture = 0;  // smaller eigenvalue of S / kArea
};

/// The variance of bilinearly interpolated white noise divided by that of the noise.
double interpolation_noise(double u, double v) {
  const double a = u - std::floor(u), b = v - std::floor(v);
  return ((1 - a) * (1 - a) + a * a) * ((1 - b) * (1 - b) + b * b);
}

/// Template and normal matrix: T(d) = I0(c0 + A^-1 d).
Template make_template(const Map& f0, const Eigen::Vector2d& c0, const Eigen::Matrix2d& A_inverse) {
  Template t;
  const auto at = [&](double du, double dv) -> Eigen::Vector2d { return c0 + A_inverse * Eigen::Vector2d(du, dv); };
  t.inside = f0.width > 1 && f0.height > 1;
  for (double dv : {-kCentre, kCentre})
    for (double du : {-kCentre, kCentre}) {
      const Eigen::Vector2d p = at(du, dv);
      // Half a pixel of slack, because a sub-pixel feature whose 8x8 patch just fits extends that far when centred.
      t.inside = t.inside && p.x() >= -0.5 && p.y() >= -0.5 && p.x() <= f0.width - 0.5 && p.y() <= f0.height - 0.5;
    }
  if (!t.inside) return t;

  std::array<double, kSupport * kSupport> I;
  for (int j = 0; j < kSupport; ++j)
    for (int i = 0; i < kSupport; ++i) {
      const Eigen::Vector2d p = at(i - 1 - kCentre, j - 1 - kCentre);
      I[j * kSupport + i] = f0.bilinear(p.x(), p.y());
    }
  t.noise = 0;
  for (int j = 0; j < kPatch; ++j)
    for (int i = 0; i < kPatch; ++i) {
      const int k = j * kPatch + i, s = (j + 1) * kSupport + i + 1;
      t.T[k] = I[s];
      t.Tu[k] = 0.5 * (I[s + 1] - I[s - 1]);
      t.Tv[k] = 0.5 * (I[s + kSupport] - I[s - kSupport]);
      t.mean += I[s] / kArea;
      const Eigen::Vector2d p = at(i - kCentre, j - kCentre);
      t.noise += interpolation_noise(p.x(), p.y()) / kArea;
    }
  Eigen::Matrix2d G = Eigen::Matrix2d::Zero();
  t.B.setZero();
  for (int k = 0; k < kArea; ++k) {
    t.T[k] -= t.mean;
    const Eigen::Vector2d g(t.Tu[k], t.Tv[k]);
    t.STT += t.T[k] * t.T[k];
    G += g * g.transpose();
    t.B.col(0) += g * t.T[k];
    t.B.col(1) += g;
  }
  if (!(t.STT > 0)) return t;
  // T has no mean, so the block of (gain, bias) is diagonal: [STT, kArea].
  t.S = G - t.B.col(0) * t.B.col(0).transpose() / t.STT - t.B.col(1) * t.B.col(1).transpose() / kArea;
  const double half = 0.5 * (t.S(0, 0) - t.S(1, 1));
  t.texture = (0.5 * (t.S(0, 0) + t.S(1, 1)) - std::sqrt(half * half + t.S(0, 1) * t.S(0, 1))) / kArea;
  const double det = t.S(0, 0) * t.S(1, 1) - t.S(0, 1) * t.S(0, 1);
  t.S_inverse << t.S(1, 1), -t.S(0, 1), -t.S(0, 1), t.S(0, 0);
  t.S_inverse /= det;
  return t;
}

/// Sums over the patch in image 1 at c1, and values that follow from them.
struct Sums {
  bool inside = false, hidden = false;
  double gain = 0, bias = 0, correlation = 0, variance = 0;  // at the position, without a step
  Eigen::Vector2d step = Eigen::Vector2d::Zero();            // px of the level
};

/// The solution of the 4x4 normal equations for I1(c1 + d) = T(d) gain + T'(d) (gain step) + bias.
Sums sum_patch(const Map& f1, const Eigen::Vector2d& c1, const Template& t) {
  Sums s;
  const double first_u = c1.x() - kCentre, first_v = c1.y() - kCentre;
  // Strictly larger than a patch, because the shader reads the ninth column and row even with zero weight.
  s.inside = f1.width > kPatch && f1.height > kPatch && first_u >= 0 && first_v >= 0 && first_u + kPatch - 1 <= f1.width - 1 &&
             first_v + kPatch - 1 <= f1.height - 1;
  if (!s.inside) return s;
  double sum_I = 0, sum_II = 0, sum_IT = 0;
  Eigen::Vector2d sum_Ig(0, 0);
  for (int k = 0; k < kArea; ++k) {
    const double I = f1.bilinear(first_u + k % kPatch, first_v + k / kPatch) - t.mean;
    sum_I += I;
    sum_II += I * I;
    sum_IT += I * t.T[k];
    sum_Ig += I * Eigen::Vector2d(t.Tu[k], t.Tv[k]);
  }
  s.hidden = sum_I > kHiddenFrom;
  s.inside = !s.hidden;
  const Eigen::Vector2d gain_step = t.S_inverse * (sum_Ig - t.B.col(0) * (sum_IT / t.STT) - t.B.col(1) * (sum_I / kArea));
  const double gain = (sum_IT - t.B.col(0).dot(gain_step)) / t.STT;
  // Inverse compositional: the step moves the template, so its inverse moves the position.
  s.step = -gain_step / gain;
  s.gain = sum_IT / t.STT;
  s.bias = sum_I / kArea + t.mean - s.gain * t.mean;
  const double variance_I = std::max(sum_II - sum_I * sum_I / kArea, 0.0);
  s.correlation = variance_I > 0 ? std::clamp(sum_IT / std::sqrt(variance_I * t.STT), -1.0, 1.0) : 0;
  s.variance = std::max(variance_I - s.gain * sum_IT, 0.0) / (kArea - 4);
  return s;
}

/// Iterations of one level from c1. The covariance is in px^2 of the level.
AlignedFeature align_level(const Map& f1, const Template& t, const Eigen::Vector2d& start, double max_motion,
                           const FeatureAlignmentOptions& options) {
  AlignedFeature f;
  Eigen::Vector2d c1 = start;
  f.status = FeatureStatus::diverged;
  for (; f.iterations < options.iterations; ++f.iterations) {
    const Sums s = sum_patch(f1, c1, t);
    if (!s.inside) {
      f.status = s.hidden ? FeatureStatus::hidden : FeatureStatus::out_of_image;
      break;
    }
    const double length = s.step.norm();
    if (!(s.gain > 0) || !std::isfinite(length)) break;
    // A step of more than a pixel exceeds the linearisation: it keeps its direction and is shortened.
    c1 += s.step * std::min(1.0, 1.0 / std::max(length, 1e-12));
    if ((c1 - start).norm() > max_motion) break;
    if (length < options.step_tolerance) {
      f.status = FeatureStatus::aligned;
      ++f.iterations;
      break;
    }
  }
  f.uv1 = c1;
  const Sums s = sum_patch(f1, c1, t);
  if (!s.inside) {
    f.status = s.hidden ? FeatureStatus::hidden : FeatureStatus::out_of_image;
    return f;
  }
  const Eigen::Matrix2d photometric = t.S_inverse * (s.variance / (s.gain * s.gain));
  if (!std::isfinite(s.gain + s.bias + s.correlation) || (f.status == FeatureStatus::aligned && !photometric.allFinite())) {
    f.status = FeatureStatus::diverged;  // NaN or infinite pixels
    return f;
  }
  f.gain = s.gain;
  f.bias = s.bias;
  f.correlation = s.correlation;
  if (f.status != FeatureStatus::aligned) return f;
  if (!(s.correlation >= options.min_correlation)) {
    f.status = FeatureStatus::bad_match;
    return f;
  }
  // Interpolation reduced the noise in the residual, but not in the position. It smooths variation from pixel to pixel, while
  // the position follows slow variation.
  const double g2 = s.gain * s.gain;
  const double smoothing = (1 + g2) / (interpolation_noise(c1.x() - kCentre, c1.y() - kCentre) + g2 * t.noise);
  f.covariance = photometric * smoothing;
  return f;
}

double scale_of(int level) { return static_cast<double>(1 << level); }

/// Converts a pixel of level 0.
Eigen::Vector2d on_level(const Eigen::Vector2d& uv, int level) {
  return uv.array() / scale_of(level) + (0.5 / scale_of(level) - 0.5);
}

}  // namespace

PatchWarp warp_patch(const Camera& camera, const Eigen::Vector2d& uv0, double q, const SE3& T_10) {
  PatchWarp w;
  const Eigen::Vector3d p = T_10.R * camera.ray(uv0) + q * T_10.t;  // X1 times q, without large numbers for far points
  const bool in_front = p.z() > 1e-6;
  w.uv1 = in_front ? camera.project(p) : Eigen::Vector2d::Zero();
  if (!in_front || !w.uv1.allFinite()) {
    w.uv1.setZero();
    w.A.setIdentity();
    return w;
  }
  w.A = camera.project_jacobian(p) * T_10.R.leftCols<2>() * Eigen::Vector2d(1 / camera.fx, 1 / camera.fy).asDiagonal();
  // A patch that shrinks or grows by more than a factor of 4 per side has a different texture at this resolution.
  const double det = w.A.determinant();
  w.valid = w.A.allFinite() && det > 1.0 / 16 && det < 16;
  return w;
}

AlignedFeature align_feature(const Pyramid& f0, const Pyramid& f1, const Camera& camera, const Eigen::Vector2d& uv0, double q,
                             const SE3& T_10, const FeatureAlignmentOptions& options, int level) {
  AlignedFeature f;
  const auto at = static_cast<size_t>(level);
  if (f0.size() <= at || f1.size() <= at || !uv0.allFinite() || !std::isfinite(q) || q <= 0) return f;
  const PatchWarp w = warp_patch(camera, uv0, q, T_10);
  f.uv1 = w.uv1;
  f.status = FeatureStatus::out_of_image;
  if (!w.valid) return f;
  const Eigen::Matrix2d A_inverse = w.A.inverse();
  const auto failed = [&](FeatureStatus status) {
    AlignedFeature g;
    g.uv1 = w.uv1;
    g.status = status;
    return g;
  };

  const Eigen::Vector2d projected = on_level(w.uv1, level);
  const double scale = scale_of(level), max_motion = options.max_motion / scale;
  const Template t0 = make_template(f0[at], on_level(uv0, level), A_inverse);
  if (!t0.inside) return failed(FeatureStatus::out_of_image);
  if (!(t0.texture > options.min_texture)) return failed(FeatureStatus::low_texture);
  const auto fine = [&](const Eigen::Vector2d& start) {
    AlignedFeature g = align_level(f1[at], t0, start, max_motion, options);
    if (g.status == FeatureStatus::aligned && (g.uv1 - projected).norm() > max_motion) g.status = FeatureStatus::diverged;
    return g;
  };

  // Level 1 has twice the basin and half the precision. It is used only if level 0 alone does not align the feature.
  AlignedFeature found = fine(projected);
  if (level == 0 && found.status != FeatureStatus::aligned && f0.size() > 1 && f1.size() > 1) {
    const Template t1 = make_template(f0[1], on_level(uv0, 1), A_inverse);
    if (t1.inside && t1.texture > options.min_texture) {
      const AlignedFeature coarse = align_level(f1[1], t1, on_level(w.uv1, 1), max_motion / 2, options);
      if (coarse.status == FeatureStatus::aligned) {
        const int iterations = found.iterations + coarse.iterations;
        found = fine((coarse.uv1.array() + 0.5) * 2 - 0.5);
        found.iterations += iterations;
      }
    }
  }
  found.uv1 = found.uv1.array() * scale + (0.5 * scale - 0.5);
  found.covariance *= scale * scale;
  return found;
}

ColourSums colour_sums(const Map& f0, std::span<const Map> rgb1, const Camera& camera, const Eigen::Vector2d& uv0, double q,
                       const SE3& T_10, const Eigen::Vector2d& uv1) {
  const Template t = make_template(f0, uv0, warp_patch(camera, uv0, q, T_10).A.inverse());
  ColourSums s;
  s.TT = t.STT;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int k = 0; k < kArea; ++k) {
    const double u = uv1.x() - kCentre + k % kPatch, v = uv1.y() - kCentre + k / kPatch;
    const Eigen::Vector3d C(rgb1[0].bilinear(u, v), rgb1[1].bilinear(u, v), rgb1[2].bilinear(u, v));
    sum += C;
    s.TC += t.T[k] * C;
    s.CC += C * C.transpose();
  }
  s.CC -= sum * sum.transpose() / kArea;
  return s;
}

}  // namespace iclk::internal
