#include <iclk/track/internal/seeder.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include <Eigen/Geometry>

#include <iclk/shaders/shared.h>
#include <iclk/track/internal/detector.h>
#include <iclk/track/internal/epipolar_search.h>

namespace iclk::internal {
namespace {

/// The share of the missing features that other keyframes may contribute, so that new features find places, too.
constexpr double kCarried = 0.6;
/// The relative sigma of an inverse depth without one.
constexpr double kRelativeSigma = 0.02;
constexpr double kInlierDistance = PoseOptions().inlier_distance;
/// The range of a seed's inverse depth, as factors of the 5th and the 95th percentile of known ones.
constexpr double kFarther = 0.6, kNearer = 1.6;
constexpr size_t kNearest = 5;  ///< known features from which a seed is initialised
/// px: the error of a position beyond its photometric noise, and the least motion by a seed's sigma that is worth a search.
constexpr double kFloor = 0.3, kWorthwhile = 0.3;
constexpr double kReach = 2;     ///< standard deviations of a seed that are searched
constexpr size_t kLookBack = 3;  ///< the most similar neighbours, in which a new keyframe's seeds are searched for
constexpr double kOffLine = 3;   ///< standard deviations from the epipolar line
/// A seed is known if its sigma is below this share of the mean inverse depth. The motion of a feature in the image is sigma
/// times the camera's motion, at every depth.
constexpr double kKnown = 0.05;
constexpr double kGoodShare = 0.55, kBadShare = 0.3;
constexpr int kWorthIt = 5;  ///< new features that are worth preparing a keyframe again

bool has_depth(const ImageView& depth, const Eigen::Vector2d& uv) {
  return !depth.empty() && depth_at(depth, static_cast<int>(std::lround(uv.x())), static_cast<int>(std::lround(uv.y()))) > 0;
}

/// A feature of another keyframe, transferred to a frame.
struct Candidate {
  Eigen::Vector2d uv;
  double q, sigma;
};

/// Feature i of a neighbour, where the frame has no depth.
std::optional<Candidate> candidate(const Camera& camera, const Neighbour& n, size_t i, const ImageView& depth) {
  const AlignedFeature& f = n.there.features[i];
  if (f.status != FeatureStatus::aligned) return {};
  const Features& features = n.keyframe->features;
  const SE3& T = n.there.T_10;
  const double q = features.inverse_depth[i];
  const Eigen::Vector3d ray = camera.ray(features.uv[i]), r = T.R * ray, p = r + q * T.t;
  if (!(p.z() > 1e-3) || !inside(camera, f.uv1, ICLK_PATCH) || has_depth(depth, f.uv1) ||
      (camera.project(p) - f.uv1).norm() > kInlierDistance)
    return {};
  const double known = i < features.inverse_depth_sigma.size() ? features.inverse_depth_sigma[i] : 0;
  const double q1 = q / p.z(), of_depth = (known > 0 ? known : kRelativeSigma * q) * r.z() / (p.z() * p.z());
  // z of T Exp(xi) X.
  Eigen::Matrix<double, 1, 6> J;
  J << T.R.row(2), (ray / q).cross(T.R.row(2).transpose()).transpose();
  const double of_pose = q1 * q1 * std::sqrt((J * n.there.covariance * J.transpose())(0));
  return Candidate{f.uv1, q1, std::hypot(of_depth, of_pose)};
}

/// The median of the inverse depths of the nearest features.
double depth_about(const Features& known, const Eigen::Vector2d& uv) {
  std::vector<std::pair<double, size_t>> near;
  for (size_t i = 0; i < known.uv.size(); ++i) near.emplace_back((known.uv[i] - uv).squaredNorm(), i);
  const size_t n = std::min(kNearest, near.size());
  std::partial_sort(near.begin(), near.begin() + static_cast<std::ptrdiff_t>(n), near.end());
  std::vector<double> about;
  for (size_t i = 0; i < n; ++i) about.push_back(known.inverse_depth[near[i].second]);
  std::sort(about.begin(), about.end());
  return about[n / 2];
}

Pyramid pyramid_of(const FramePixels& pixels, const Camera& camera) { return Frame(pixels.frame(camera)).pyramid(); }

}  // namespace

void Seeder::carry(const TrackFrame& frame, std::span<const Neighbour> neighbours, Features& to) const {
  auto most = static_cast<int>(kCarried * (options_.features - to.size()));
  std::vector<Candidate> candidates;
  for (const Neighbour& n : neighbours) {
    if (!judge_.confirmed(n.there)) continue;
    for (size_t i = 0; i < n.there.features.size(); ++i)
      if (const auto c = candidate(camera_, n, i, frame.depth)) candidates.push_back(*c);
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.sigma < b.sigma; });
  to.inverse_depth_sigma.resize(to.uv.size());
  for (const Candidate& c : candidates) {
    if (most <= 0) break;
    const bool taken = std::any_of(to.uv.begin(), to.uv.end(), [&](const Eigen::Vector2d& uv) {
      return (uv - c.uv).lpNorm<Eigen::Infinity>() < kCornerDistance;
    });
    if (taken) continue;
    to.uv.push_back(c.uv);
    to.inverse_depth.push_back(c.q);
    to.inverse_depth_sigma.push_back(c.sigma);
    --most;
  }
}

void Seeder::sow(Keyframe& k, Frame& frame) const {
  std::vector<double> known = k.features.inverse_depth;
  std::sort(known.begin(), known.end());
  const size_t twentieth = known.size() / 20;
  const double low = kFarther * known[twentieth], high = kNearer * known[known.size() - 1 - twentieth];
  const TrackFrame& seen = frame.seen();
  for (const Eigen::Vector2d& uv :
       detect_seeds(frame.grey(), seen.depth, seen.mask, k.features.uv, options_.seeds, options_.border)) {
    k.seeds.push_back({uv, DepthFilter::between(low, high)});
    k.seeds.back().filter.mean = depth_about(k.features, uv);
  }
}

void Seeder::look_for(Keyframe::Seed& seed, const Pyramid& f1, const SE3& T_10, const Matrix6d& covariance) const {
  DepthFilter& filter = seed.filter;
  const Eigen::Vector2d& uv = seed.uv;
  if (parallax(camera_, uv, filter.mean, T_10) * filter.sigma < kWorthwhile) return;
  const Eigen::Vector3d p = T_10.R * camera_.ray(uv) + filter.mean * T_10.t;
  if (!(p.z() > 1e-3) || !camera_.contains(camera_.project(p))) return;
  const double low = std::max(filter.mean - kReach * filter.sigma, 0.05 * filter.mean);
  const auto found = search_epipolar(looked_, f1, camera_, uv, low, filter.mean + kReach * filter.sigma, T_10);
  const auto seen = found ? triangulate(camera_, uv, T_10, found->uv1,
                                        found->covariance + kFloor * kFloor * Eigen::Matrix2d::Identity(), covariance)
                          : std::nullopt;
  if (seen && seen->off_line < kOffLine)
    filter.add(*seen);
  else
    filter.miss();
}

/// Searches for the seeds of the keyframe in another image.
void Seeder::sight(Keyframe& k, const Pyramid& f1, const SE3& T_10, const Matrix6d& covariance) const {
  for (Keyframe::Seed& seed : k.seeds) look_for(seed, f1, T_10, covariance);
  std::erase_if(k.seeds, [](const Keyframe::Seed& s) { return s.filter.inlier_share() < kBadShare || !(s.filter.mean > 0); });
}

/// Makes features of the seeds that are known now, if there are at least `least`.
bool Seeder::harvest(Keyframe& k, int least) const {
  const double enough = kKnown * mean_inverse_depth(k);
  const auto known = [&](const Keyframe::Seed& s) {
    return s.filter.sigma < enough && s.filter.inlier_share() > kGoodShare && s.filter.mean > s.filter.sigma;
  };
  const auto ready = std::count_if(k.seeds.begin(), k.seeds.end(), known);
  const int count = std::min(static_cast<int>(ready), options_.features - k.features.size());
  if (count < least || count <= 0) return false;
  for (int taken = 0; taken < count; ++taken) {
    const auto next = std::find_if(k.seeds.begin(), k.seeds.end(), known);
    k.features.uv.push_back(next->uv);
    k.features.inverse_depth.push_back(next->filter.mean);
    k.features.inverse_depth_sigma.push_back(next->filter.sigma);
    k.measured.push_back(next->filter.mean);
    k.sigma.push_back(next->filter.sigma);
    k.seeds.erase(next);
  }
  if (k.features.size() == options_.features) k.seeds.clear();
  return true;
}

bool Seeder::look_back(Keyframe& k, Frame& frame, std::span<const Neighbour> neighbours) {
  if (k.seeds.empty()) return false;
  looked_at_ = k.id;
  looked_ = frame.pyramid();
  for (const Neighbour& n : neighbours.first(std::min(kLookBack, neighbours.size())))
    if (judge_.confirmed(n.back))
      sight(k, pyramid_of(n.keyframe->pixels, camera_), n.keyframe->T_WC.inverse() * k.T_WC, n.back.covariance);
  return harvest(k, 1);
}

bool Seeder::look(Keyframe& k, Frame& frame, const RefinedAlignment& a) {
  if (looked_at_ != k.id) {
    looked_ = pyramid_of(k.pixels, camera_);
    looked_at_ = k.id;
  }
  sight(k, frame.pyramid(), a.T_10, a.covariance);
  return harvest(k, std::min(kWorthIt, static_cast<int>(k.seeds.size())));
}

}  // namespace iclk::internal
