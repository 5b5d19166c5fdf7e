#include <algorithm>
#include <map>
#include <utility>

#include <iclk/track/internal/tracker_impl.h>

namespace iclk {
namespace {

/// Of a pose that nothing but the alignment itself speaks for: rad, and the same seen at the mean depth.
constexpr double kWeakSigma = 0.03;

Matrix6d edge_covariance(const Keyframe::Origin& origin, const Keyframe& from) {
  if (origin.confirmed) return origin.covariance;
  const double distance = 1 / mean_inverse_depth(from);
  Vector6d sigma;
  sigma << Eigen::Vector3d::Constant(kWeakSigma * distance), Eigen::Vector3d::Constant(kWeakSigma);
  return sigma.cwiseAbs2().asDiagonal();
}

}  // namespace

std::vector<Tracker::Impl::Neighbour> Tracker::Impl::neighbours_of(const TrackFrame& frame, const SE3& T_WC,
                                                                   const Found* found) {
  std::vector<Neighbour> out;
  std::vector<Pair> pairs;
  std::vector<size_t> of;
  // The one that leaves for the new one is none of them.
  const int leaves = keyframes.size() == options.keyframes ? keyframes.all().begin()->first : -1;
  for (const int id : keyframes.best(camera, T_WC, static_cast<size_t>(options.window) + 1, 0.3)) {
    if (id == leaves || out.size() == static_cast<size_t>(options.window)) continue;
    out.push_back({id, {}, {}});
    if (found && id == found->keyframe) {
      out.back().there = found->alignment;
      continue;
    }
    of.push_back(out.size() - 1);
    pairs.push_back(pair_with(id, frame, T_WC, false));
  }
  if (pairs.empty()) return out;
  std::vector<RefinedAlignment> there = refiner.align(pairs);
  for (size_t i = 0; i < of.size(); ++i) out[of[i]].there = std::move(there[i]);
  return out;
}

void Tracker::Impl::connect(Keyframe& k, std::vector<Neighbour>& neighbours) {
  std::vector<Pair> pairs;
  std::vector<Neighbour*> of;
  for (Neighbour& n : neighbours) {
    if (!confirmed(n.there)) continue;  // where one way fails, so does the other: 95 of 100
    const Keyframe& other = *keyframes.find(n.id);
    of.push_back(&n);
    pairs.push_back(pair_with(k.id, other.pixels.frame(camera), other.T_WC, false));
  }
  if (pairs.empty()) return;
  std::vector<RefinedAlignment> back = refiner.align(pairs);
  for (size_t i = 0; i < of.size(); ++i) {
    Neighbour& n = *of[i];
    n.back = std::move(back[i]);
    keyframes.find(n.id)->sightings[k.id] = n.there.features;
    if (confirmed(n.back)) k.sightings[n.id] = n.back.features;
  }
}

void Tracker::Impl::adjust_window() {
  // The newest are free; what they are connected with holds them.
  const int first_free = std::max(keyframes.all().begin()->first + 1, keyframes.count() - options.window);
  std::map<int, bool> part;
  for (const auto& [id, k] : keyframes.all()) {
    if (id >= first_free) part[id] = true;
    if (id >= first_free && k.origin && keyframes.find(k.origin->keyframe)) part[k.origin->keyframe] = true;
    for (const auto& [seen_in, features] : k.sightings)
      if (id >= first_free || seen_in >= first_free) part[id] = part[seen_in] = true;
  }
  std::map<int, int> index;  // in the bundle
  std::vector<BundleFrame> frames;
  for (const auto& [id, ignored] : part) {
    const Keyframe& k = *keyframes.find(id);
    index[id] = static_cast<int>(frames.size());
    frames.push_back({k.T_WC, id < first_free, k.features.uv, k.features.inverse_depth, k.measured, k.sigma});
  }
  std::vector<BundleSighting> sightings;
  for (const auto& [id, at] : index)
    for (const auto& [seen_in, features] : keyframes.find(id)->sightings) {
      const auto other = index.find(seen_in);
      if (other == index.end()) continue;
      for (size_t i = 0; i < features.size(); ++i)
        if (features[i].status == FeatureStatus::aligned)
          sightings.push_back({at, static_cast<int>(i), other->second, features[i].uv1, features[i].covariance});
    }
  std::vector<BundleEdge> edges;
  for (const auto& [id, at] : index) {
    const auto& origin = keyframes.find(id)->origin;
    if (!origin || !index.count(origin->keyframe)) continue;
    const Keyframe& from = *keyframes.find(origin->keyframe);
    if (from.sightings.count(id) > 0) continue;  // which say more
    edges.push_back({index[origin->keyframe], at, origin->T_CK, edge_covariance(*origin, from)});
  }
  if (!adjust(camera, frames, sightings, edges, options.bundle).usable) return;
  for (const auto& [id, at] : index) {
    const BundleFrame& frame = frames[static_cast<size_t>(at)];
    if (frame.fixed) continue;
    keyframes.set_pose(id, frame.T_WC);
    keyframes.find(id)->features.inverse_depth = frame.inverse_depth;
    set_reference(*keyframes.find(id));
  }
}

}  // namespace iclk
