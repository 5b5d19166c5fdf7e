#include <iclk/refine/internal/blur.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <numbers>

#include <unsupported/Eigen/FFT>

#include <iclk/refine/internal/align_feature.h>

namespace iclk::internal {
namespace {

using Eigen::ArrayXf;
using Eigen::Vector2d;
using Spectrum = Eigen::Matrix<std::complex<float>, Eigen::Dynamic, Eigen::Dynamic>;

constexpr int kSize = 64;     // px: side of a patch
constexpr int kPatches = 64;  // at most
constexpr int kLeastPatches = 4;
constexpr double kBand = 0.2;          // cycles per pixel: higher frequencies are mostly noise
constexpr double kTexture = -2.4;      // exponent of the power of textures
constexpr double kModelError = 0.1;    // share of the power
constexpr int kShift = 5;              // px: largest error of the pose at a patch
constexpr double kLongest = 30;        // px
constexpr double kLeastLine = 5;       // px: shorter blur does not need to be matched
constexpr double kLeastGain = 0.3;     // of the mean log-likelihood
constexpr float kBlurCost = 0.15f;     // of it, for each image that is not sharp
constexpr double kShortened = 0.9;     // what the window leaves of a line's length
constexpr int kLargestArea = 500'000;  // px: larger images are halved

/// Frequencies of the upper half plane inside the band.
struct Band {
  std::vector<std::pair<int, int>> bins;  // column, row
  ArrayXf fu, fv, weight, texture;

  Band() {
    std::vector<Vector2d> f;
    for (int row = 0; row < kSize; ++row)
      for (int column = 0; column < kSize; ++column) {
        const Vector2d at(signed_frequency(column), signed_frequency(row));
        if (at.norm() < 0.9 / kSize || at.norm() >= kBand || at.x() < 0 || (at.x() == 0 && at.y() < 0)) continue;
        bins.emplace_back(column, row);
        f.push_back(at);
      }
    const auto n = static_cast<Eigen::Index>(f.size());
    fu.resize(n), fv.resize(n), weight.resize(n), texture.resize(n);
    for (Eigen::Index i = 0; i < n; ++i) {
      const Vector2d& at = f[static_cast<size_t>(i)];
      fu[i] = static_cast<float>(at.x());
      fv[i] = static_cast<float>(at.y());
      weight[i] = static_cast<float>(1 / at.norm());  // all octaves weigh the same
      texture[i] = static_cast<float>(std::pow(at.norm(), kTexture));
    }
    weight /= weight.sum();
  }
  static double signed_frequency(int bin) { return static_cast<double>(bin < kSize / 2 ? bin : bin - kSize) / kSize; }
};
const Band& band() {
  static const Band known;
  return known;
}

/// The two-dimensional transform, in place.
void transform(Spectrum& x, bool inverse) {
  thread_local Eigen::FFT<float> fft;
  Eigen::Matrix<std::complex<float>, Eigen::Dynamic, 1> line(kSize), out(kSize);
  const auto apply = [&] { inverse ? fft.inv(out, line) : fft.fwd(out, line); };
  for (int i = 0; i < kSize; ++i) line = x.row(i).transpose(), apply(), x.row(i) = out.transpose();
  for (int i = 0; i < kSize; ++i) line = x.col(i), apply(), x.col(i) = out;
}

/// A patch of a map around `centre`, warped by A, under a Hann window and without its mean.
Spectrum patch_spectrum(const Map& map, const Vector2d& centre, const Eigen::Matrix2d& A) {
  Eigen::MatrixXf grey(kSize, kSize);
  for (int v = 0; v < kSize; ++v)
    for (int u = 0; u < kSize; ++u) {
      const Vector2d at = centre + A * Vector2d(u - 0.5 * (kSize - 1), v - 0.5 * (kSize - 1));
      grey(v, u) = static_cast<float>(map.bilinear(at.x(), at.y()));
    }
  const Eigen::ArrayXf hann =
      0.5f - 0.5f * (2 * std::numbers::pi_v<float> / (kSize - 1) * Eigen::ArrayXf::LinSpaced(kSize, 0, kSize - 1)).cos();
  grey = (grey.array() - grey.mean()) * (hann.matrix() * hann.matrix().transpose()).array();
  Spectrum out = grey.cast<std::complex<float>>();
  transform(out, false);
  return out;
}

/// Where the correlation is largest, to a fraction of a pixel. `cross`: conj(A) B.
Vector2d shift_of(Spectrum cross) {
  for (int row = 0; row < kSize; ++row)
    for (int column = 0; column < kSize; ++column)
      if (std::hypot(Band::signed_frequency(column), Band::signed_frequency(row)) >= kBand) cross(row, column) = 0;
  transform(cross, true);
  const auto value = [&](int u, int v) { return cross((v + kSize) % kSize, (u + kSize) % kSize).real(); };
  int u = 0, v = 0;
  for (int y = -kShift; y <= kShift; ++y)
    for (int x = -kShift; x <= kShift; ++x)
      if (value(x, y) > value(u, v)) u = x, v = y;
  const auto peak = [](float before, float here, float after) {
    const float bend = before - 2 * here + after;
    return bend < 0 ? std::clamp(0.5 * (before - after) / bend, -0.5, 0.5) : 0.0;
  };
  return {u + peak(value(u - 1, v), value(u, v), value(u + 1, v)), v + peak(value(u, v - 1), value(u, v), value(u, v + 1))};
}

/// Means over the patches, each patch with a power of 1.
struct Spectra {
  ArrayXf A, B, cross;
  Eigen::Matrix2d to_target = Eigen::Matrix2d::Zero();
  int patches = 0;

  void add(const Spectrum& a, const Spectrum& b, const Eigen::Matrix2d& warp) {
    Spectrum product = a.conjugate().cwiseProduct(b);
    const Vector2d shift = shift_of(product);
    const auto n = static_cast<Eigen::Index>(band().bins.size());
    ArrayXf power_a(n), power_b(n), common(n);
    for (Eigen::Index i = 0; i < n; ++i) {
      const auto [column, row] = band().bins[static_cast<size_t>(i)];
      power_a[i] = std::norm(a(row, column));
      power_b[i] = std::norm(b(row, column));
      const double turn = 2 * std::numbers::pi * (band().fu[i] * shift.x() + band().fv[i] * shift.y());
      common[i] = (product(row, column) * std::polar(1.0f, static_cast<float>(turn))).real();
    }
    const float sum_a = power_a.sum(), sum_b = power_b.sum();
    if (!(sum_a > 1e-6f && sum_b > 1e-6f) || !std::isfinite(sum_a * sum_b)) return;
    if (patches == 0) A = B = cross = ArrayXf::Zero(n);
    A += power_a / sum_a;
    B += power_b / sum_b;
    cross += common / std::sqrt(sum_a * sum_b);
    to_target += warp;
    ++patches;
  }
};

bool inside(const Map& map, const Vector2d& at) {
  return at.x() >= 0 && at.y() >= 0 && at.x() <= map.width - 1 && at.y() <= map.height - 1;
}

Spectra spectra_of(const Map& f0, const Map& f1, const Camera& camera, const Features& features, const SE3& T_10,
                   double scale) {
  Spectra out;
  const int count = features.size(), step = std::max(1, count / kPatches);
  const double half = 0.5 * kSize;
  if (std::min(f0.width, f0.height) <= kSize) return out;
  for (int i = 0; i < count && out.patches < kPatches; i += step) {
    const double q = features.inverse_depth[static_cast<size_t>(i)];
    const Vector2d& given = features.uv[static_cast<size_t>(i)];
    if (!(q > 0) || !std::isfinite(q) || !given.allFinite()) continue;
    Vector2d uv = (given.array() + 0.5) / scale - 0.5;
    uv = {std::clamp(std::round(uv.x()), half, f0.width - 1 - half),
          std::clamp(std::round(uv.y()), half, f0.height - 1 - half)};
    const PatchWarp warp = warp_patch(camera, uv, q, T_10);
    if (!warp.valid) continue;
    bool fits = true;
    for (const double x : {-half, half})
      for (const double y : {-half, half}) fits = fits && inside(f1, warp.uv1 + warp.A * Vector2d(x, y));
    if (fits) out.add(patch_spectrum(f0, uv, Eigen::Matrix2d::Identity()), patch_spectrum(f1, warp.uv1, warp.A), warp.A);
  }
  return out;
}

/// The likelihoods of lines.
class Likelihood {
 public:
  explicit Likelihood(const Spectra& s)
      : A_(s.A / static_cast<float>(s.patches)),
        B_(s.B / static_cast<float>(s.patches)),
        cross_(s.cross / static_cast<float>(s.patches)),
        noise_a_(noise(A_)),
        noise_b_(noise(B_)) {}

  /// What a line makes of the texture, in both images: its amplitude. Each has the power that the image has.
  struct Line {
    ArrayXf in_a, in_b;
  };
  Line line(const Vector2d& ends) const {
    const ArrayXf x =
        std::numbers::pi_v<float> * (static_cast<float>(ends.x()) * band().fu + static_cast<float>(ends.y()) * band().fv);
    const ArrayXf K = (x.abs() < 1e-3f).select(1.0f, x.sin() / x) * band().texture.sqrt();
    const float power = (band().weight * K.square()).sum();
    return {K * std::sqrt(signal(A_, noise_a_) / power), K * std::sqrt(signal(B_, noise_b_) / power)};
  }

  /// -2 log-likelihood, a weighted mean over the frequencies.
  float cost(const ArrayXf& k0, const ArrayXf& k1) const {
    const ArrayXf aa = k0.square() + noise_a_ + kShare * A_, bb = k1.square() + noise_b_ + kShare * B_, ab = k0 * k1;
    const ArrayXf det = aa * bb - ab.square();
    return (band().weight * ((det / (A_ * B_)).log() + (bb * A_ + aa * B_ - 2 * ab * cross_) / det)).sum();
  }

 private:
  static constexpr float kShare = static_cast<float>(kModelError);
  static float noise(const ArrayXf& power) {
    std::vector<float> sorted(power.begin(), power.end());
    std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 10), sorted.end());
    return std::max(0.8f * sorted[sorted.size() / 10], 1e-12f);
  }
  static float signal(const ArrayXf& power, float noise) { return std::max((band().weight * (power - noise)).sum(), 1e-12f); }

  ArrayXf A_, B_, cross_;
  float noise_a_, noise_b_;
};

struct Lines {
  Vector2d first = Vector2d::Zero(), second = Vector2d::Zero();
  float cost = 0;
};

/// The best pair of lines of a grid.
Lines best_of_grid(const Likelihood& likelihood) {
  std::vector<Vector2d> ends{Vector2d::Zero()};
  for (const double length : {5.0, 8.0, 11.0, 14.0, 18.0, 22.0, 27.0})
    for (int k = 0; k < 12; ++k)
      ends.emplace_back(length * std::cos(k * std::numbers::pi / 12), length * std::sin(k * std::numbers::pi / 12));
  std::vector<Likelihood::Line> lines;
  for (const Vector2d& e : ends) lines.push_back(likelihood.line(e));
  Lines best{{}, {}, likelihood.cost(lines[0].in_a, lines[0].in_b)};
  for (size_t i = 0; i < ends.size(); ++i)
    for (size_t j = 0; j < ends.size(); ++j)
      if (const float c = likelihood.cost(lines[i].in_a, lines[j].in_b) + kBlurCost * static_cast<float>((i > 0) + (j > 0));
          c < best.cost)
        best = {ends[i], ends[j], c};
  return best;
}

/// Moves the ends of both lines, by smaller and smaller steps.
Lines polished(const Likelihood& likelihood, Lines best) {
  for (const double step : {1.5, 0.7, 0.3})
    for (bool better = true; better;) {
      better = false;
      for (int k = 0; k < 8; ++k) {
        Lines moved = best;
        Vector2d& end = k < 4 ? moved.first : moved.second;
        if (end.isZero()) continue;  // sharp
        end[k / 2 % 2] += k % 2 == 0 ? step : -step;
        if (std::max(moved.first.norm(), moved.second.norm()) > kLongest) continue;
        moved.cost = likelihood.cost(likelihood.line(moved.first).in_a, likelihood.line(moved.second).in_b) +
                     kBlurCost * static_cast<float>(!moved.first.isZero() + !moved.second.isZero());
        if (moved.cost < best.cost - 1e-5f) best = moved, better = true;
      }
    }
  return best;
}

/// Opposite lines are the same line.
double difference(const Vector2d& a, const Vector2d& b) { return std::min((a - b).norm(), (a + b).norm()); }

}  // namespace

std::optional<PairBlur> find_blur(const Map& f0, const Map& f1, const Camera& camera, const Features& features,
                                  const SE3& T_10) {
  int level = 0;
  Map small0 = f0, small1 = f1;
  for (; small0.width * small0.height > kLargestArea; ++level) small0 = half_size(small0), small1 = half_size(small1);
  const double scale = std::exp2(level), longer = scale / kShortened;
  const Spectra spectra = spectra_of(small0, small1, camera.at_level(level), features, T_10, scale);
  if (spectra.patches < kLeastPatches) return {};
  const Likelihood likelihood(spectra);
  const Likelihood::Line sharp = likelihood.line(Vector2d::Zero());
  const Lines best = polished(likelihood, best_of_grid(likelihood));
  const bool proven = likelihood.cost(sharp.in_a, sharp.in_b) - best.cost > kLeastGain;
  if (!proven || difference(best.first, best.second) < kLeastLine) return {};
  const Eigen::Matrix2d to_target = spectra.to_target / spectra.patches;
  return PairBlur{longer * best.first, longer * (to_target * best.second), longer * (to_target * best.first),
                  longer * best.second};
}

}  // namespace iclk::internal
