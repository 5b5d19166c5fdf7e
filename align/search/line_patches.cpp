#include <iclk/align/search/line_patches.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/LU>

#include <iclk/align/common/each.h>
#include <iclk/align/common/input.h>
#include <iclk/align/search/matching.h>

namespace iclk::internal {
namespace {

using Eigen::Index;
using Eigen::MatrixXf;
using Eigen::Vector2d;

constexpr Index kHalf = 12;   // pixels of the map to either side of a patch's centre
constexpr Index kBorder = 8;  // pixels of the map around the target, the largest reach
constexpr Index kSide = 2 * kHalf + 1;
constexpr int kHypotheses = 512;

/// Sums at places below each other: at least 2 * 8 + 1, in whole vectors of four.
using Column = Eigen::Array<float, 20, 1>;
constexpr Index kBelow = Column::RowsAtCompileTime;  // pixels below the target

/// Adds the products of one column of a patch with those of a map that begin at `map` and below it.
void add_products(const float* patch, const float* map, Column& sums) {
  for (Index y = 0; y < kSide; ++y) sums += patch[y] * Eigen::Map<const Column>(map + y);
}

/// How a pose maps the surroundings of a feature.
struct Warp {
  Vector2d place;
  Eigen::Matrix2d A;  ///< derivative
};

/// Nothing if they are behind the camera, or seen from the side.
std::optional<Warp> warp_of(const Camera& camera, const Vector2d& centre, double inverse_depth, int scale, const SE3& T_10) {
  const auto place = [&](const Vector2d& at) -> Vector2d {
    const Eigen::Vector3d X = T_10.R * camera.ray((at.array() + 0.5) * scale - 0.5) + T_10.t * inverse_depth;
    if (!(X.z() > 0)) return Vector2d::Constant(NAN);
    return (camera.project(X).array() + 0.5) / scale - 0.5;
  };
  Warp warp{place(centre), {}};
  for (int axis = 0; axis < 2; ++axis) {
    const Vector2d step = kHalf * Vector2d::Unit(axis);
    warp.A.col(axis) = (place(centre + step) - place(centre - step)) / (2 * kHalf);
  }
  if (!warp.place.allFinite() || !(warp.A.determinant() > 0.1)) return {};
  return warp;
}

}  // namespace

LinePatches::LinePatches(const Map& reference, const Map& target, int scale)
    : known_(distinct(lines_of(reference, scale), kHalf)), scale_(scale) {
  const Lines seen = distinct(lines_of(target, scale), kHalf);
  real_ = imag_ = MatrixXf::Zero(seen.rows() + kBorder + kBelow, seen.cols() + 2 * kBorder);
  real_.block(kBorder, kBorder, seen.rows(), seen.cols()) = seen.real();
  imag_.block(kBorder, kBorder, seen.rows(), seen.cols()) = seen.imag();
}

std::optional<LinePatches::Compared> LinePatches::find(const Camera& camera, const Vector2d& uv, double inverse_depth,
                                                       const SE3& T_10, int reach) const {
  const Vector2d centre = (uv.array() + 0.5) / scale_ - 0.5;
  const std::optional<Warp> found = warp_of(camera, centre, inverse_depth, scale_, T_10);
  if (!found) return {};
  const Warp& warp = *found;
  const Index width = real_.cols() - 2 * kBorder, height = real_.rows() - kBorder - kBelow;
  const auto u = static_cast<Index>(std::lround(warp.place.x())), v = static_cast<Index>(std::lround(warp.place.y()));
  if (u < kHalf || v < kHalf || u + kHalf >= width || v + kHalf >= height) return {};
  const Eigen::Matrix2d back = warp.A.inverse();
  const double roll = std::atan2(warp.A(1, 0) - warp.A(0, 1), warp.A(0, 0) + warp.A(1, 1));
  const std::complex<float> turn = std::polar(1.0f, static_cast<float>(2 * roll));
  MatrixXf real(kSide, kSide), imag(kSide, kSide);
  for (Index x = 0; x < kSide; ++x)
    for (Index y = 0; y < kSide; ++y) {
      const Vector2d from_place = Vector2d(u + x - kHalf, v + y - kHalf) - warp.place;
      const std::complex<float> line = turn * sample(known_, centre + back * from_place);
      real(y, x) = line.real(), imag(y, x) = line.imag();
    }
  const float norm = std::sqrt(real.squaredNorm() + imag.squaredNorm());
  if (!(norm > 0)) return {};
  MatrixXf scores(2 * reach + 1, 2 * reach + 1);
  const Index left = u - kHalf - reach + kBorder, top = v - kHalf - reach + kBorder;
  for (Index x = 0; x < scores.cols(); ++x) {
    Column sums = Column::Zero();
    for (Index column = 0; column < kSide; ++column) {
      add_products(&real(0, column), &real_(top, left + x + column), sums);
      add_products(&imag(0, column), &imag_(top, left + x + column), sums);
    }
    scores.col(x) = sums.head(scores.rows()).matrix() / norm;
  }
  Index y = 0, x = 0;
  const float best = scores.maxCoeff(&y, &x);
  if (!(best > 0)) return {};
  if (x == 0 || y == 0 || x + 1 == scores.cols() || y + 1 == scores.rows()) return Compared{};
  const Vector2d place(static_cast<double>(u + x - reach) + peak(scores(y, x - 1), best, scores(y, x + 1)),
                       static_cast<double>(v + y - reach) + peak(scores(y - 1, x), best, scores(y + 1, x)));
  return Compared{Correspondence{camera.ray(uv), (place.array() + 0.5) * scale_ - 0.5, best}};
}

PairLines::PairLines(const Reference& reference, const Pair& pair)
    : reference_(grey_map(reference.image)), target_(visible_map(pair.target, pair.target_mask)) {}

const LinePatches& PairLines::at(int scale) { return patches_.try_emplace(scale, reference_, target_, scale).first->second; }

std::vector<LineRound> line_rounds(const Camera& camera) {
  const int scale = match_layout(camera).scale;
  return {{scale, 8, 0.125}, {scale, 4}, {std::max(1, scale / 2)}, {1}};
}

std::optional<LinePose> match_line_patches(const Reference& reference, std::span<const FeatureCheck> checks, PairLines& lines,
                                           const SE3& start, std::span<const LineRound> rounds, int threads) {
  const Camera& camera = reference.camera;
  MatchLayout layout = match_layout(camera);
  const double mean_q = mean_inverse_depth(reference, checks, false);
  if (!layout.enabled || !(mean_q > 0)) return {};
  LinePose pose{start};
  for (const LineRound& round : rounds) {
    const LinePatches& patches = lines.at(round.scale);
    layout.scale = round.scale;
    const size_t count = static_cast<size_t>(std::min(reference.features.size(), layout.features));
    std::vector<std::optional<LinePatches::Compared>> found(count);
    for_each_of(count, threads, [&](size_t match) {
      const auto i = static_cast<size_t>(matched_feature(static_cast<int>(match), reference.features.size()));
      if (checks[i] != FeatureCheck::ok) return;
      const double q = reference.features.inverse_depth[i];
      found[match] = patches.find(camera, reference.features.uv[i], q, pose.T_10, round.reach);
      if (found[match] && found[match]->match) found[match]->match->point *= mean_q / q;
    });
    std::vector<Correspondence> all;
    const auto compared = std::count_if(found.begin(), found.end(), [](const auto& c) { return c.has_value(); });
    for (const auto& c : found)
      if (c && c->match) all.push_back(*c->match);
    std::stable_sort(all.begin(), all.end(), [](const auto& a, const auto& b) { return a.distinct > b.distinct; });
    const double share = round.share * static_cast<double>(compared) / static_cast<double>(std::max<size_t>(all.size(), 1));
    const auto agreed = pose_of(all, camera, mean_q, layout, kHypotheses, share);
    if (!agreed) return {};
    pose = {agreed->T_10, agreed->agreeing, static_cast<int>(compared)};
  }
  return pose;
}

}  // namespace iclk::internal
