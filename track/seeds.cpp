// Features where no depth is known: carried over from other keyframes, and seeds, whose depths the following frames tell.
#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Geometry>

#include <iclk/shaders/shared.h>
#include <iclk/track/epipolar_search.h>
#include <iclk/track/internal/tracker_impl.h>

namespace iclk {
namespace {

/// Of an inverse depth that comes without one.
constexpr double kRelativeSigma = 0.02;
/// What is seen at once, beyond the depths that are known: shares of the 5th and the 95th percentile.
constexpr double kFarther = 0.6, kNearer = 1.6;
constexpr size_t kNearest = 5;  ///< known features that say where a seed may begin
/// px: what a position is wrong by beyond its photometric noise, and how much a seed's sigma has to move it to be looked for.
constexpr double kFloor = 0.3, kWorthwhile = 0.3;
constexpr double kReach = 2;     ///< standard deviations of a seed that are searched
constexpr size_t kLookBack = 3;  ///< neighbours in which a new keyframe's seeds are looked for: those that are most alike
constexpr double kOffLine = 3;   ///< standard deviations from the epipolar line
/// A seed is known if its sigma is below this share of the mean inverse depth: what moves a feature in the image is sigma times
/// the camera's motion, whatever its depth.
constexpr double kKnown = 0.05;
constexpr double kGoodShare = 0.55, kBadShare = 0.3;

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

bool has_depth(const ImageView& depth, const Eigen::Vector2d& uv) {
  if (depth.empty()) return false;
  const auto u = static_cast<size_t>(std::lround(uv.x()));
  return reinterpret_cast<const float*>(depth.row(static_cast<int>(std::lround(uv.y()))))[u] > 0;
}

}  // namespace

void Tracker::Impl::carry(const TrackFrame& frame, const std::vector<Neighbour>& neighbours, int most, Features& to) const {
  struct Candidate {
    Eigen::Vector2d uv;
    double q, sigma;
  };
  std::vector<Candidate> candidates;
  for (const Neighbour& n : neighbours) {
    if (!confirmed(n.there)) continue;
    const Keyframe& k = keyframes.all().at(n.id);
    const SE3& T = n.there.T_10;
    for (size_t i = 0; i < n.there.features.size(); ++i) {
      const AlignedFeature& f = n.there.features[i];
      const double q = k.features.inverse_depth[i];
      if (f.status != FeatureStatus::aligned) continue;
      const Eigen::Vector3d ray = camera.ray(k.features.uv[i]), r = T.R * ray, p = r + q * T.t;
      constexpr double kBorder = ICLK_PATCH;
      if (!(p.z() > 1e-3) || !(f.uv1.array() >= kBorder).all() || f.uv1.x() > camera.width - 1 - kBorder ||
          f.uv1.y() > camera.height - 1 - kBorder || has_depth(frame.depth, f.uv1) ||
          (camera.project(p) - f.uv1).norm() > options.refiner.pose.inlier_distance)
        continue;
      const double known = i < k.features.inverse_depth_sigma.size() ? k.features.inverse_depth_sigma[i] : 0;
      const double q1 = q / p.z(), of_depth = (known > 0 ? known : kRelativeSigma * q) * r.z() / (p.z() * p.z());
      // z of T Exp(xi) X.
      Eigen::Matrix<double, 1, 6> J;
      J << T.R.row(2), (ray / q).cross(T.R.row(2).transpose()).transpose();
      const double of_pose = q1 * q1 * std::sqrt((J * n.there.covariance * J.transpose())(0));
      candidates.push_back({f.uv1, q1, std::hypot(of_depth, of_pose)});
    }
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.sigma < b.sigma; });
  to.inverse_depth_sigma.resize(to.uv.size());
  for (const Candidate& c : candidates) {
    if (most <= 0) break;
    const bool taken = std::any_of(to.uv.begin(), to.uv.end(), [&](const Eigen::Vector2d& uv) {
      return (uv - c.uv).lpNorm<Eigen::Infinity>() < options.detector.distance;
    });
    if (taken) continue;
    to.uv.push_back(c.uv);
    to.inverse_depth.push_back(c.q);
    to.inverse_depth_sigma.push_back(c.sigma);
    --most;
  }
}

void Tracker::Impl::sow(Keyframe& k, const Map& grey, const TrackFrame& frame) {
  const std::vector<double>& known = k.features.inverse_depth;
  const std::vector<Eigen::Vector2d>& places = k.features.uv;
  std::vector<double> sorted = known;
  std::sort(sorted.begin(), sorted.end());
  const double low = kFarther * sorted[sorted.size() / 20], high = kNearer * sorted[sorted.size() - 1 - sorted.size() / 20];
  for (const Eigen::Vector2d& uv : detect_seeds(grey, frame.depth, frame.mask, places, options.seeds, options.detector)) {
    std::vector<std::pair<double, size_t>> near;
    for (size_t i = 0; i < places.size(); ++i) near.emplace_back((places[i] - uv).squaredNorm(), i);
    const size_t n = std::min(kNearest, near.size());
    std::partial_sort(near.begin(), near.begin() + static_cast<std::ptrdiff_t>(n), near.end());
    std::vector<double> about;
    for (size_t i = 0; i < n; ++i) about.push_back(known[near[i].second]);
    k.seeds.push_back({uv, DepthFilter::between(low, high)});
    k.seeds.back().filter.mean = median(std::move(about));
  }
}

void Tracker::Impl::sight(Keyframe& k, const Pyramid& f0, const Pyramid& f1, const SE3& T_10, const Matrix6d& covariance) {
  for (Keyframe::Seed& seed : k.seeds) {
    DepthFilter& filter = seed.filter;
    const Eigen::Vector2d& uv = seed.uv;
    if (parallax(camera, uv, filter.mean, T_10) * filter.sigma < kWorthwhile) continue;
    const Eigen::Vector3d p = T_10.R * camera.ray(uv) + filter.mean * T_10.t;
    if (!(p.z() > 1e-3) || !camera.contains(camera.project(p))) continue;
    const double low = std::max(filter.mean - kReach * filter.sigma, 0.05 * filter.mean);
    const auto found = search_epipolar(f0, f1, camera, uv, low, filter.mean + kReach * filter.sigma, T_10);
    const auto seen = found ? triangulate(camera, uv, T_10, found->uv1,
                                          found->covariance + kFloor * kFloor * Eigen::Matrix2d::Identity(), covariance)
                            : std::nullopt;
    if (seen && seen->off_line < kOffLine)
      filter.add(*seen);
    else
      filter.miss();
  }
  std::erase_if(k.seeds, [](const Keyframe::Seed& s) { return s.filter.inlier_share() < kBadShare || !(s.filter.mean > 0); });
}

int Tracker::Impl::harvest(Keyframe& k, int least) {
  const double enough = kKnown * mean_inverse_depth(k);
  const auto known = [&](const Keyframe::Seed& s) {
    return s.filter.sigma < enough && s.filter.inlier_share() > kGoodShare && s.filter.mean > s.filter.sigma;
  };
  const auto ready = std::count_if(k.seeds.begin(), k.seeds.end(), known);
  const int count = std::min(static_cast<int>(ready), options.detector.count - k.features.size());
  if (count < least || count <= 0) return 0;
  for (int taken = 0; taken < count; ++taken) {
    const auto next = std::find_if(k.seeds.begin(), k.seeds.end(), known);
    k.features.uv.push_back(next->uv);
    k.features.inverse_depth.push_back(next->filter.mean);
    k.features.inverse_depth_sigma.push_back(next->filter.sigma);
    k.measured.push_back(next->filter.mean);
    k.sigma.push_back(next->filter.sigma);
    k.seeds.erase(next);
  }
  if (k.features.size() == options.detector.count) k.seeds.clear();
  return count;
}

Pyramid Tracker::Impl::pyramid(const TrackFrame& frame) const {
  Pyramid out = grey_pyramid(frame.image, kFeatureAlignmentLevels);
  if (!frame.mask.empty()) hide(out, frame.mask);
  return out;
}

void Tracker::Impl::look_back(Keyframe& k, const std::vector<Neighbour>& neighbours) {
  if (k.seeds.empty()) return;
  const Pyramid f0 = pyramid(k.pixels.frame(camera));
  for (const Neighbour& n : std::span(neighbours).first(std::min(kLookBack, neighbours.size()))) {
    const Keyframe* other = keyframes.find(n.id);
    if (!other || !confirmed(n.back)) continue;
    sight(k, f0, pyramid(other->pixels.frame(camera)), other->T_WC.inverse() * k.T_WC, n.back.covariance);
  }
  if (harvest(k, 1) > 0) set_reference(k);
}

void Tracker::Impl::look(Keyframe& k, const TrackFrame& frame, const RefinedAlignment& a) {
  if (k.seeds.empty()) return;
  if (looked_at != k.id) {
    looked_pyramid = pyramid(k.pixels.frame(camera));
    looked_at = k.id;
  }
  sight(k, looked_pyramid, pyramid(frame), a.T_10, a.covariance);
  constexpr int kWorthIt = 5;  // to prepare the keyframe anew
  if (harvest(k, std::min(kWorthIt, static_cast<int>(k.seeds.size()))) > 0) set_reference(k);
}

}  // namespace iclk
