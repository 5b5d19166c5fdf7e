#include <iclk/align/search/gradients.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Geometry>

#include <iclk/align/common/each.h>
#include <iclk/align/common/input.h>
#include <iclk/align/search/line_patches.h>

namespace iclk::internal {
namespace {

using Eigen::Vector2d;
using Patch = Gradients::Patch;

constexpr int kDirections = Gradients::kDirections;
constexpr int kCell = 3;    // pixels of the map
constexpr int kStep = 2;    // pixels of the map between the places that are compared first
constexpr int kApart = 16;  // pixels of the map; nearer places belong to one peak
constexpr int kHypotheses = 1024;
constexpr double kShare = 0.08;      // of the correspondences, which must agree with a start
constexpr double kClearShare = 0.3;  // of the same, with which a start is certain; wrong ones reach 0.27
constexpr int kRolls = 12;           // of a full turn
constexpr float kLeastNorm = 1e-3f;  // of a descriptor with texture

/// From the middle of a patch to that of its last cells.
double reach(const Patch& patch) { return 0.5 * (patch.side - 1) * kCell; }

/// The gradient of a pixel, shared between the directions: about linearly between the two nearest ones.
Eigen::Array<float, kDirections, 1> by_direction(float gu, float gv) {
  static const Eigen::Matrix<float, kDirections, 2> directions = [] {
    Eigen::Matrix<float, kDirections, 2> d;
    for (int k = 0; k < kDirections; ++k)
      d.row(k) << std::cos(2 * static_cast<float>(M_PI) * k / kDirections),
          std::sin(2 * static_cast<float>(M_PI) * k / kDirections);
    return d;
  }();
  const float squared = gu * gu + gv * gv;
  if (!(squared > 0)) return Eigen::Array<float, kDirections, 1>::Zero();  // also NaN
  const Eigen::Array<float, kDirections, 1> along = (directions.col(0) * gu + directions.col(1) * gv).array().max(0.0f);
  return (along.square() / squared).square().square() * std::sqrt(squared);
}

/// The places of a target that are compared first.
struct Places {
  Places(const Gradients& gradients, const Patch& of) : target(gradients), patch(of) {
    const double border = reach(patch);
    for (double v = border; v <= target.height() - 1 - border; v += kStep)
      for (double u = border; u <= target.width() - 1 - border; u += kStep) at.emplace_back(u, v);
    descriptors = target.describe(at, patch);
  }

  const Gradients& target;
  const Patch& patch;
  std::vector<Vector2d> at;
  Gradients::Descriptors descriptors;
};

/// Histograms of an image that is rolled.
Eigen::Array<float, kDirections, 1> rolled(const Eigen::Array<float, kDirections, 1>& directions, double roll) {
  if (roll == 0) return directions;
  Eigen::Array<float, kDirections, 1> out;
  for (int k = 0; k < kDirections; ++k) {
    const double from = k - roll / (2 * M_PI) * kDirections;
    const auto whole = static_cast<int>(std::floor(from));
    const auto part = static_cast<float>(from - whole);
    const auto at = [&](int i) { return directions[(i % kDirections + kDirections) % kDirections]; };
    out[k] = (1 - part) * at(whole) + part * at(whole + 1);
  }
  return out;
}

/// The best of the places, and how much better it is than those elsewhere.
std::pair<size_t, float> best_place(const Eigen::Ref<const Eigen::VectorXf>& scores, const std::vector<Vector2d>& at) {
  Eigen::Index best = 0;
  const float most = scores.maxCoeff(&best);
  float next = 0;
  for (Eigen::Index k = 0; k < scores.size(); ++k)
    if (scores[k] > next && (at[static_cast<size_t>(k)] - at[static_cast<size_t>(best)]).lpNorm<Eigen::Infinity>() > kApart)
      next = scores[k];
  return {static_cast<size_t>(best), most - next};
}

/// The best position near a place, to a fraction of a pixel of the map.
Vector2d refined(const Gradients& target, const Eigen::Ref<const Eigen::VectorXf>& descriptor, const Patch& patch,
                 const Vector2d& place) {
  constexpr int kWide = 2 * kStep + 1;
  std::vector<Vector2d> near;
  for (int v = -kStep; v <= kStep; ++v)
    for (int u = -kStep; u <= kStep; ++u) near.push_back(place + Vector2d(u, v));
  const Eigen::VectorXf scores = target.describe(near, patch).transpose() * descriptor;
  Eigen::Index best = 0;
  scores.maxCoeff(&best);
  Vector2d at = near[static_cast<size_t>(best)];
  const Eigen::Index u = best % kWide, v = best / kWide;
  if (u > 0 && u < kWide - 1) at.x() += peak(scores[best - 1], scores[best], scores[best + 1]);
  if (v > 0 && v < kWide - 1) at.y() += peak(scores[best - kWide], scores[best], scores[best + kWide]);
  return at;
}

}  // namespace

/// Cosines over both sides of the patch, Fourier series over the directions: the products of the lowest frequencies but the
/// mean. As in MatchDescriptor, each is weighted by the root of its frequency.
Patch::Patch(int n, int numbers) : side(n), basis(numbers, n * n * kDirections) {
  const auto wave = [n](int frequency, int at) {
    return std::sqrt((frequency == 0 ? 1.0 : 2.0) / n) * std::cos(M_PI * (at + 0.5) * frequency / n);
  };
  // 1, cos, sin, cos 2, sin 2, cos 3, sin 3, cos 4
  const auto turn = [](int number, int at) {
    const double angle = 2 * M_PI * at / kDirections * ((number + 1) / 2), norm = number == 0 || number == 7 ? 1.0 : 2.0;
    return std::sqrt(norm / kDirections) * (number % 2 == 1 ? std::cos(angle) : number == 0 ? 1.0 : std::sin(angle));
  };
  struct Wave {
    int squared, i, j, number;
  };
  std::vector<Wave> waves;
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j)
      for (int k = 0; k < kDirections; ++k) waves.push_back({i * i + j * j + (k + 1) / 2 * ((k + 1) / 2), i, j, k});
  std::stable_sort(waves.begin(), waves.end(), [](const Wave& a, const Wave& b) { return a.squared < b.squared; });
  for (int row = 0; row < numbers; ++row) {
    const Wave& w = waves[static_cast<size_t>(row + 1)];  // the first one is the mean
    for (int k = 0; k < basis.cols(); ++k)
      basis(row, k) = static_cast<float>(std::pow(w.squared, 0.25) * wave(w.i, k / (n * kDirections)) *
                                         wave(w.j, k / kDirections % n) * turn(w.number, k % kDirections));
  }
}

const Patch& Patch::small() {
  static const Patch patch(4, 64);
  return patch;
}

const Patch& Patch::large() {
  static const Patch patch(6, 128);
  return patch;
}

Gradients::Gradients(Map grey, int scale, int threads)
    : width_(grey.width / scale), height_(grey.height / scale), cells_(kDirections, width_ * height_) {
  for (float& value : grey.data)
    if (!(value < kHiddenFrom)) value = NAN;
  Cells sums(kDirections, width_ * height_);
  for_each_of(static_cast<size_t>(height_), threads, [&](size_t row) {
    for (int u = 0; u < width_; ++u) {
      auto sum = sums.col(static_cast<Eigen::Index>(row) * width_ + u);
      sum.setZero();
      for (int y = static_cast<int>(row) * scale; y < (static_cast<int>(row) + 1) * scale; ++y)
        for (int x = u * scale; x < (u + 1) * scale; ++x) {
          if (x == 0 || y == 0 || x == grey.width - 1 || y == grey.height - 1) continue;
          sum += by_direction(grey.at(x + 1, y) - grey.at(x - 1, y), grey.at(x, y + 1) - grey.at(x, y - 1));
        }
    }
  });
  for_each_of(static_cast<size_t>(height_), threads, [&](size_t row) {
    for (int u = 0; u < width_; ++u) {
      Eigen::Array<float, kDirections, 1> sum = Eigen::Array<float, kDirections, 1>::Zero();
      for (int y = -1; y <= 1; ++y)
        for (int x = -1; x <= 1; ++x)
          sum += sums.col(std::clamp(static_cast<int>(row) + y, 0, height_ - 1) * width_ + std::clamp(u + x, 0, width_ - 1));
      cells_.col(static_cast<Eigen::Index>(row) * width_ + u) =
          (sum / static_cast<float>(kCell * kCell * scale * scale)).sqrt();
    }
  });
}

Gradients::Descriptors Gradients::describe(const std::vector<Vector2d>& centres, const Patch& patch, double roll) const {
  const Eigen::Matrix2d back = Eigen::Rotation2Dd(-roll).toRotationMatrix();
  Eigen::MatrixXf cells(patch.basis.cols(), centres.size());
  for (size_t k = 0; k < centres.size(); ++k)
    for (int cell = 0; cell < patch.side * patch.side; ++cell) {
      const Vector2d from_centre = Vector2d(cell % patch.side, cell / patch.side) * kCell - Vector2d::Constant(reach(patch));
      const Vector2d at = centres[k] + back * from_centre;
      const double u = std::clamp(at.x(), 0.0, width_ - 1.0), v = std::clamp(at.y(), 0.0, height_ - 1.0);
      const int x = std::min(static_cast<int>(u), width_ - 2), y = std::min(static_cast<int>(v), height_ - 2);
      const auto a = static_cast<float>(u - x), b = static_cast<float>(v - y);
      const Eigen::Index first = y * width_ + x;
      const Eigen::Array<float, kDirections, 1> here =
          (1 - b) * ((1 - a) * cells_.col(first) + a * cells_.col(first + 1)) +
          b * ((1 - a) * cells_.col(first + width_) + a * cells_.col(first + width_ + 1));
      cells.col(static_cast<Eigen::Index>(k)).segment<kDirections>(cell * kDirections) = rolled(here, roll);
    }
  Descriptors out = patch.basis * cells;
  for (auto column : out.colwise()) {
    const float norm = column.norm();
    if (norm > kLeastNorm)
      column /= norm;
    else
      column.setZero();  // also NaN
  }
  return out;
}

namespace {

struct Sought {
  const Gradients& gradients;
  std::vector<Vector2d> centres;        // pixels of the map
  std::vector<Eigen::Vector3d> points;  // Correspondence::point
};

Sought sought_features(const Gradients& gradients, const Reference& reference, std::span<const FeatureCheck> checks,
                       double mean_q, const MatchLayout& layout) {
  const Features& features = reference.features;
  Sought out{gradients, {}, {}};
  for (int match = 0; match < std::min(features.size(), layout.features); ++match) {
    const auto i = static_cast<size_t>(matched_feature(match, features.size()));
    if (checks[i] != FeatureCheck::ok) continue;
    out.centres.emplace_back((features.uv[i].array() + 0.5) / layout.scale - 0.5);
    out.points.emplace_back(reference.camera.ray(features.uv[i]) * (mean_q / features.inverse_depth[i]));
  }
  return out;
}

/// correspondences() by gradients.
std::vector<Correspondence> correspondences(const Sought& sought, const Places& places, double roll, int scale) {
  std::vector<Correspondence> found;
  if (sought.centres.empty() || places.at.empty()) return found;
  const Gradients::Descriptors wanted = sought.gradients.describe(sought.centres, places.patch, roll);
  const Eigen::MatrixXf scores = places.descriptors.transpose() * wanted;
  for (Eigen::Index k = 0; k < scores.cols(); ++k) {
    const auto [best, distinct] = best_place(scores.col(k), places.at);
    if (!(scores(static_cast<Eigen::Index>(best), k) > 0)) continue;
    const Vector2d place = refined(places.target, wanted.col(k), places.patch, places.at[best]);
    found.push_back({sought.points[static_cast<size_t>(k)], (place.array() + 0.5) * scale - 0.5, distinct});
  }
  std::stable_sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.distinct > b.distinct; });
  return found;
}

/// The pose that moves the features as the lines of the whole image move.
std::vector<Correspondence> moved(const Sought& sought, const Similarity& motion, int scale) {
  std::vector<Correspondence> all;
  for (size_t k = 0; k < sought.centres.size(); ++k) {
    const Vector2d place = motion((sought.centres[k].array() + 0.5) / 2 - 0.5);  // at half the size
    all.push_back({sought.points[k], (place.array() + 0.5) * 2 * scale - 0.5, 1});
  }
  return all;
}

/// The motion of the whole image, in pixels of maps at this scale.
std::optional<Similarity> motion_of(const Reference& reference, const Pair& pair, int scale, int threads) {
  const Map target = visible_map(pair.target, pair.target_mask);
  return match_lines(lines_of(grey_map(reference.image), scale), lines_of(target, scale), threads);
}

/// The pose near another one on which patches of lines agree, as fine as they allow.
std::optional<SE3> near_by_lines(const Reference& reference, std::span<const FeatureCheck> checks, const Pair& pair,
                                 const SE3& near, int threads) {
  PairLines lines(reference, pair);
  const std::vector<LineRound> rounds = line_rounds(reference.camera);
  const std::span<const LineRound> coarse = std::span(rounds).first(2), fine = std::span(rounds).subspan(2);
  const auto found = match_line_patches(reference, checks, lines, near, coarse, threads);
  if (!found) return {};
  const auto finer = match_line_patches(reference, checks, lines, found->T_10, fine, threads);
  return finer ? finer->T_10 : found->T_10;
}

}  // namespace

std::optional<SE3> start_by_gradients(const Reference& reference, std::span<const FeatureCheck> checks, const Pair& pair,
                                      int threads) {
  const Camera& camera = reference.camera;
  const MatchLayout layout = match_layout(camera);
  if (!layout.enabled) return {};
  const double mean_q = mean_inverse_depth(reference, checks, false);
  if (!(mean_q > 0)) return {};
  const Gradients of_reference(grey_map(reference.image), layout.scale, threads),
      of_target(visible_map(pair.target, pair.target_mask), layout.scale, threads);
  const Sought sought = sought_features(of_reference, reference, checks, mean_q, layout);
  struct Start {
    SE3 T_10;
    double share;  // of the correspondences that agree
  };
  const auto agreed = [&](const std::vector<Correspondence>& all) -> std::optional<Start> {
    const auto pose = pose_of(all, camera, mean_q, layout, kHypotheses, kShare);
    if (!pose) return {};
    return Start{pose->T_10, pose->agreeing / static_cast<double>(all.size())};
  };
  const auto start = [&](const Places& places, double roll) {
    return agreed(correspondences(sought, places, roll, layout.scale));
  };
  const auto certain = [](const std::optional<Start>& s) { return s && s->share >= kClearShare; };
  const Places small(of_target, Patch::small());
  std::optional<Start> best = start(small, 0);
  if (!best) best = start(Places(of_target, Patch::large()), 0);
  double needed = best ? kClearShare : 0;  // of a start at another roll
  for (int roll = 1; roll < kRolls && !certain(best); ++roll) {
    const std::optional<Start> rolled = start(small, 2 * M_PI * roll / kRolls);
    if (rolled && rolled->share >= needed) best = rolled, needed = rolled->share;
  }
  if (best) return best->T_10;
  if (const auto motion = motion_of(reference, pair, 2 * layout.scale, threads))
    if (const auto near = agreed(moved(sought, *motion, layout.scale)))
      return near_by_lines(reference, checks, pair, near->T_10, threads);
  return {};
}

}  // namespace iclk::internal
