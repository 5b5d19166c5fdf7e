#include <iclk/align/search/matching.h>

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

#include <iclk/align/search/p3p.h>

namespace iclk::internal {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kPatch = ICLK_PATCH, kNumbers = 4 * ICLK_MATCH_TEXELS;

// Frequencies (vertical, horizontal) in the order of shaders/search/match_descriptor.glsl.
constexpr int kFrequencies[kNumbers][2] = {{0, 1}, {0, 2}, {0, 3}, {0, 4}, {1, 0}, {1, 1}, {1, 2}, {1, 3},
                                           {2, 0}, {2, 1}, {2, 2}, {2, 3}, {3, 0}, {3, 1}, {3, 2}, {4, 0}};

float cosine(int frequency, int at) {
  return static_cast<float>((frequency == 0 ? std::sqrt(0.125) : 0.5) * std::cos(M_PI * (at + 0.5) * frequency / kPatch));
}

struct Basis {
  std::array<std::array<float, ICLK_PATCH_AREA>, kNumbers> rows;
  Basis() {
    for (size_t n = 0; n < kNumbers; ++n) {
      const auto [i, j] = kFrequencies[n];
      const double weight = std::pow(i * i + j * j, 0.25);
      for (int k = 0; k < ICLK_PATCH_AREA; ++k)
        rows[n][static_cast<size_t>(k)] = static_cast<float>(weight) * cosine(i, k / kPatch) * cosine(j, k % kPatch);
    }
  }
};

float dot(const MatchDescriptor& a, const MatchDescriptor& b) {
  float sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
  return sum;
}

uint32_t hash(uint32_t x) {  // PCG, as in shaders/search/hypothesise.comp
  x = x * 747796405u + 2891336453u;
  x = ((x >> ((x >> 28) + 4)) ^ x) * 277803737u;
  return (x >> 22) ^ x;
}

// The costs of poses for correspondences; shaders/search/match_cost.glsl.
class Agreeing {
 public:
  Agreeing(const std::vector<Correspondence>& all, const Camera& camera, double tolerance)
      : all_(all), camera_(camera), tolerance_(tolerance), columns_(static_cast<Eigen::Index>(all.size()), 5) {
    for (Eigen::Index k = 0; k < columns_.rows(); ++k) {
      const Correspondence& c = all[static_cast<size_t>(k)];
      const Vector2d from_centre = c.pixel - Vector2d(camera.cx, camera.cy);
      columns_.row(k) << c.point.transpose().cast<float>(), from_centre.transpose().cast<float>();
    }
    const Eigen::Index stride = std::max<Eigen::Index>(columns_.rows() / kEnough, 1);
    some_.resize((columns_.rows() + stride - 1) / stride, 5);
    for (Eigen::Index k = 0; k < some_.rows(); ++k) some_.row(k) = columns_.row(k * stride);
  }

  struct Cost {
    double cost = 0;
    int inliers = 0;
  };
  Cost cost(const SE3& T) const { return cost(T, columns_); }
  // The cost on a sample of at least kEnough correspondences, enough to compare hypotheses.
  Cost rough_cost(const SE3& T) const { return cost(T, some_); }

  // One Gauss-Newton step with Tukey's weights, T <- Exp(xi) T.
  SE3 refined(const SE3& T) const {
    Matrix6d H = Matrix6d::Zero();
    Vector6d g = Vector6d::Zero();
    for (size_t k = 0; k < all_.size(); ++k) {
      Vector3d X;
      const Vector2d r = residual(T, k, X);
      const double keep = 1 - r.squaredNorm() / (4 * tolerance_ * tolerance_);
      if (!(keep > 0)) continue;
      Eigen::Matrix<double, 2, 6> J;
      J.leftCols<3>() = camera_.project_jacobian(X);
      J.rightCols<3>() = -J.leftCols<3>() * hat(X);
      H += keep * keep * J.transpose() * J;
      g += keep * keep * J.transpose() * r;
    }
    H.diagonal() *= 1 + 1e-5;
    const Vector6d xi = H.ldlt().solve(g);
    if (!(xi.squaredNorm() < 1)) return T;
    SE3 moved = SE3::exp(xi) * T;
    moved.orthonormalize();
    return moved;
  }

 private:
  Vector2d residual(const SE3& T, size_t k, Vector3d& seen) const {
    seen = T * all_[k].point;
    return seen.z() > ICLK_LEAST_DEPTH ? all_[k].pixel - camera_.project(seen) : Vector2d(1e9, 1e9);
  }

  using Columns = Eigen::Array<float, Eigen::Dynamic, 5>;  // point, pixel from the principal point
  static constexpr Eigen::Index kEnough = 256;

  // Uses arrays, which the compiler vectorises, because it is called for hundreds of hypotheses.
  Cost cost(const SE3& T, const Columns& of) const {
    const Eigen::Matrix3f R = T.R.cast<float>();
    const Eigen::Vector3f t = T.t.cast<float>();
    const auto X = [&](int i) { return R(i, 0) * of.col(0) + R(i, 1) * of.col(1) + R(i, 2) * of.col(2) + t[i]; };
    const auto fx = static_cast<float>(camera_.fx), fy = static_cast<float>(camera_.fy);
    const Eigen::ArrayXf z = X(2), per_z = z.inverse();
    const float unit = 1 / static_cast<float>(tolerance_ * tolerance_);
    const Eigen::ArrayXf squared = unit * ((of.col(3) - fx * X(0) * per_z).square() + (of.col(4) - fy * X(1) * per_z).square());
    // Not min(): the residual of a point too far for a float is NaN.
    const Eigen::ArrayXf e = (z > float{ICLK_LEAST_DEPTH} && squared < 1.0f).select(squared, 1.0f);
    return {static_cast<double>(e.sum()), static_cast<int>((e < 1).count())};
  }

  const std::vector<Correspondence>& all_;
  const Camera& camera_;
  double tolerance_;
  Columns columns_, some_;
};

}  // namespace

MatchLayout::MatchLayout(const Plan& plan, const AlignerOptions& options) {
  enabled = options.search && !plan.dense;
  while ((plan.width / scale) * (plan.height / scale) > ICLK_MATCH_AREA) ++scale;
  width = plan.width / scale;
  height = plan.height / scale;
  // The map must fit several patches side by side, or matches cannot be distinct.
  enabled = enabled && width >= 3 * kPatch && height >= 3 * kPatch;
  if (!enabled) return;
  places_x = width - kPatch + 1;
  places_y = height - kPatch + 1;
  tiles_x = (places_x + ICLK_MATCH_TILE - 1) / ICLK_MATCH_TILE;
  tiles_y = (places_y + ICLK_MATCH_TILE - 1) / ICLK_MATCH_TILE;
  features = std::min(plan.max_features, ICLK_MATCH_FEATURES);
  first_level = std::min(static_cast<int>(std::lround(std::log2(scale))), options.levels - 1);
}

double peak(float before, float here, float after) {
  const float bend = before - 2 * here + after;
  return bend < 0 ? std::clamp(0.5f * (before - after) / bend, -0.5f, 0.5f) : 0;
}

MatchLayout match_layout(const Camera& camera) {
  AlignerOptions options;
  options.search = true;
  Plan plan{camera.width, camera.height};
  plan.max_features = ICLK_MATCH_FEATURES;
  return MatchLayout(plan, options);
}

int matched_feature(int match, int count) {
  return static_cast<int>(static_cast<float>(match) *
                          std::max(1.0f, static_cast<float>(count) / static_cast<float>(ICLK_MATCH_FEATURES)));
}

MatchDescriptor describe(const std::array<float, ICLK_PATCH_AREA>& patch) {
  static const Basis basis;
  MatchDescriptor d;
  float size = 0;
  for (size_t n = 0; n < d.size(); ++n) {
    d[n] = 0;
    for (size_t k = 0; k < patch.size(); ++k) d[n] += basis.rows[n][k] * patch[k];
    size += d[n] * d[n];
  }
  const bool textured = size >= ICLK_MATCH_LEAST * ICLK_MATCH_LEAST && size < 1e30f;  // false for NaN
  for (float& x : d) x = textured ? x / std::sqrt(size) : 0;
  return d;
}

PlaceDescriptors describe_places(const Map& map, const MatchLayout& layout) {
  using Rows = Eigen::Array<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const Eigen::Map<const Rows> grey(map.data.data(), map.height, map.width);
  std::array<Rows, 5> along;  // by horizontal frequency
  for (int j = 0; j < 5; ++j) {
    Rows& sum = along[static_cast<size_t>(j)] = Rows::Zero(map.height, layout.places_x);
    for (int x = 0; x < kPatch; ++x) sum += cosine(j, x) * grey.middleCols(x, layout.places_x);
  }
  PlaceDescriptors out(kNumbers, layout.places());
  for (int n = 0; n < kNumbers; ++n) {
    const auto [i, j] = kFrequencies[n];
    const auto weight = static_cast<float>(std::pow(i * i + j * j, 0.25));
    Eigen::Map<Rows> to(out.row(n).data(), layout.places_y, layout.places_x);
    to.setZero();
    for (int y = 0; y < kPatch; ++y) to += weight * cosine(i, y) * along[static_cast<size_t>(j)].middleRows(y, layout.places_y);
  }
  const Eigen::Array<float, 1, Eigen::Dynamic> size = out.colwise().squaredNorm();
  const auto textured = size >= ICLK_MATCH_LEAST * ICLK_MATCH_LEAST && size < 1e30f;  // false for NaN
  const Eigen::Array<float, 1, Eigen::Dynamic> scale = textured.select(size.rsqrt(), 0.0f);
  for (int n = 0; n < kNumbers; ++n) out.row(n).array() = textured.select(out.row(n).array() * scale, 0.0f);
  return out;
}

Map match_map(const Map& grey, const MatchLayout& layout) {
  Map out(layout.width, layout.height);
  const int s = layout.scale;
  for (int v = 0; v < out.height; ++v)
    for (int u = 0; u < out.width; ++u) {
      float sum = 0;
      for (int y = 0; y < s; ++y)
        for (int x = 0; x < s; ++x) sum += grey.at(u * s + x, v * s + y);
      out.at(u, v) = sum / static_cast<float>(s * s);
    }
  return out;
}

std::vector<Correspondence> correspondences(const Map& map0, const Map& map1, const Features& features,
                                            std::span<const FeatureCheck> checks, const Camera& camera,
                                            double mean_inverse_depth, const MatchLayout& layout, Rolls which) {
  std::vector<MatchDescriptor> places(static_cast<size_t>(layout.places()));
  std::array<float, ICLK_PATCH_AREA> patch;
  for (int k = 0; k < layout.places(); ++k) {
    for (int p = 0; p < ICLK_PATCH_AREA; ++p)
      patch[static_cast<size_t>(p)] = map1.at(k % layout.places_x + p % kPatch, k / layout.places_x + p / kPatch);
    places[static_cast<size_t>(k)] = describe(patch);
  }
  const auto place = [&](int u, int v) -> const MatchDescriptor& {
    return places[static_cast<size_t>(v * layout.places_x + u)];
  };
  std::vector<Correspondence> found;
  const int count = features.size();
  const int taking_part = std::min(count, layout.features),
            sought = which == Rolls::all ? taking_part : std::min(taking_part, ICLK_MATCH_UPRIGHT_FEATURES);
  for (int match = 0; match < sought; ++match) {
    const auto i = static_cast<size_t>(matched_feature(match * taking_part / sought, count));
    if (checks[i] != FeatureCheck::ok) continue;
    const Vector2d centre = (features.uv[i].array() + 0.5) / layout.scale - 0.5;
    std::vector<MatchDescriptor> rolls;
    for (int roll = 0; roll < ICLK_MATCH_ROLLS; ++roll) {
      if (which == Rolls::upright && roll != ICLK_MATCH_ROLLS / 2) continue;
      const double angle = (roll - 0.5 * (ICLK_MATCH_ROLLS - 1)) * ICLK_MATCH_ROLL;
      const Vector2d along(std::cos(angle), std::sin(angle)), down(-along.y(), along.x());
      for (int p = 0; p < ICLK_PATCH_AREA; ++p) {
        const Vector2d at = centre + (p % kPatch - 3.5) * along + (p / kPatch - 3.5) * down;
        patch[static_cast<size_t>(p)] = static_cast<float>(map0.bilinear(at.x(), at.y()));
      }
      rolls.push_back(describe(patch));
    }
    const auto score = [&](const MatchDescriptor& d) {
      float most = -2;
      for (const MatchDescriptor& roll : rolls) most = std::max(most, dot(roll, d));
      return most;
    };
    // The best place of each tile, then of all tiles, then of those not adjacent to it.
    std::vector<std::pair<float, int>> tiles(static_cast<size_t>(layout.tiles()), {0, -1});
    for (int v = 0; v < layout.places_y; ++v)
      for (int u = 0; u < layout.places_x; ++u) {
        auto& tile = tiles[static_cast<size_t>(v / ICLK_MATCH_TILE * layout.tiles_x + u / ICLK_MATCH_TILE)];
        if (const float s = score(place(u, v)); s > tile.first) tile = {s, v * layout.places_x + u};
      }
    size_t best = 0;
    for (size_t k = 0; k < tiles.size(); ++k)
      if (tiles[k].first > tiles[best].first) best = k;
    if (tiles[best].second < 0) continue;
    float next = 0;
    const auto column = [&](size_t k) { return static_cast<int>(k) % layout.tiles_x; };
    const auto row = [&](size_t k) { return static_cast<int>(k) / layout.tiles_x; };
    for (size_t k = 0; k < tiles.size(); ++k)
      if (std::abs(column(k) - column(best)) > 1 || std::abs(row(k) - row(best)) > 1) next = std::max(next, tiles[k].first);
    const int u = tiles[best].second % layout.places_x, v = tiles[best].second / layout.places_x;
    const auto& roll = *std::max_element(
        rolls.begin(), rolls.end(), [&](const auto& a, const auto& b) { return dot(a, place(u, v)) < dot(b, place(u, v)); });
    const auto at = [&](int x, int y) { return dot(roll, place(x, y)); };
    Vector2d pixel(u, v);
    if (u > 0 && u < layout.places_x - 1) pixel.x() += peak(at(u - 1, v), at(u, v), at(u + 1, v));
    if (v > 0 && v < layout.places_y - 1) pixel.y() += peak(at(u, v - 1), at(u, v), at(u, v + 1));
    pixel = (pixel.array() + 0.5 * kPatch) * layout.scale - 0.5;
    const Vector3d point = camera.ray(features.uv[i]) * (mean_inverse_depth / features.inverse_depth[i]);
    found.push_back({point, pixel, tiles[best].first - next});
  }
  std::stable_sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.distinct > b.distinct; });
  return found;
}

double repeats(const std::vector<Correspondence>& all) {
  const auto alike = std::count_if(all.begin(), all.end(), [](const auto& c) { return c.distinct < float{ICLK_MATCH_ALIKE}; });
  return static_cast<double>(alike) / static_cast<double>(std::max<size_t>(all.size(), 1));
}

std::array<uint32_t, 3> three_of(uint32_t count, uint32_t number) {
  const uint32_t i = hash(3 * number) % count;
  uint32_t j = hash(3 * number + 1) % (count - 1), k = hash(3 * number + 2) % (count - 2);
  j += j >= i;
  k += k >= std::min(i, j);
  k += k >= std::max(i, j);
  return {i, j, k};
}

std::optional<AgreedPose> pose_of(const std::vector<Correspondence>& all, const Camera& camera, double mean_inverse_depth,
                                  const MatchLayout& layout, int hypotheses, double share_of_all) {
  const auto count = static_cast<uint32_t>(all.size());
  if (count < 4 || repeats(all) >= ICLK_MATCH_REPEATS) return {};
  const Agreeing agreeing(all, camera, ICLK_MATCH_TOLERANCE * layout.scale);
  struct Hypothesis {
    SE3 T;
    double cost = 1e30;
  };
  std::array<Hypothesis, ICLK_MATCH_GROUP> best;  // one of each share of the hypotheses
  for (uint32_t number = 0; number < static_cast<uint32_t>(hypotheses); ++number) {
    const uint32_t pool = number % 2 == 0 ? count : std::min(count, std::max(count / 4, 12u));
    const auto [i, j, k] = three_of(pool, number);
    Hypothesis& share = best[number % ICLK_MATCH_GROUP];
    const std::array<Vector3d, 3> points = {all[i].point, all[j].point, all[k].point};
    for (const SE3& T : p3p(points, {camera.ray(all[i].pixel), camera.ray(all[j].pixel), camera.ray(all[k].pixel)})) {
      double before = 0, after = 0;
      for (const Vector3d& X : points) before += X.norm(), after += (T * X).norm();
      if (!(after < ICLK_MATCH_NEARER * before && ICLK_MATCH_NEARER * after > before)) continue;
      if (const double cost = agreeing.rough_cost(T).cost; cost < share.cost) share = {T, cost};
    }
  }
  std::optional<AgreedPose> start;
  double least = 1e30;
  for (Hypothesis& h : best) {
    if (h.cost >= 1e30) continue;
    for (int i = 0; i < ICLK_MATCH_STEPS; ++i) h.T = agreeing.refined(h.T);
    const auto [cost, inliers] = agreeing.cost(h.T);
    if (inliers < ICLK_MATCH_INLIERS + share_of_all * count || cost >= least) continue;
    least = cost;
    start = {h.T, inliers};
    start->T_10.t /= mean_inverse_depth;
  }
  return start;
}

MatchedStart matched_start(const Map& map0, const Map& map1, const Features& features, std::span<const FeatureCheck> checks,
                           const Camera& camera, double mean_inverse_depth, const MatchLayout& layout) {
  const auto start = [&](Rolls rolls, int hypotheses, double share) -> MatchedStart {
    const auto all = correspondences(map0, map1, features, checks, camera, mean_inverse_depth, layout, rolls);
    const auto pose = pose_of(all, camera, mean_inverse_depth, layout, hypotheses, share);
    return {pose ? std::optional(pose->T_10) : std::nullopt, repeats(all)};
  };
  const MatchedStart upright = start(Rolls::upright, ICLK_MATCH_UPRIGHT_HYPOTHESES, ICLK_MATCH_UPRIGHT_SHARE);
  return upright.T_10 ? upright : start(Rolls::all, ICLK_MATCH_HYPOTHESES, ICLK_MATCH_SHARE);
}

}  // namespace iclk::internal
