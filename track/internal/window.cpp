#include <iclk/track/internal/window.h>

#include <algorithm>
#include <map>
#include <set>
#include <utility>

namespace iclk::internal {
namespace {

constexpr double kLeastVisible = 0.3;  ///< of a neighbour's features
constexpr double kMostDrift = 0.05;    ///< of the image's width, of an older keyframe that the window is connected with
constexpr double kFloor = 0.5;         ///< px: BundleOptions::floor

}  // namespace

std::vector<Neighbour> Window::neighbours_of(const TrackFrame& frame, const SE3& T_WC, const Found* found) {
  std::vector<Neighbour> out;
  std::vector<Pair> pairs;
  std::vector<size_t> of;
  const auto most = static_cast<size_t>(size_);
  for (const int id : keyframes_.best(T_WC, most + 1, kLeastVisible)) {
    if (id == keyframes_.leaving() || out.size() == most) continue;
    out.push_back({keyframes_.find(id)});
    if (found && id == found->keyframe) {
      out.back().there = found->alignment;
      continue;
    }
    of.push_back(out.size() - 1);
    pairs.push_back(pair_of(*out.back().keyframe, frame, T_WC));
  }
  if (pairs.empty()) return out;
  std::vector<RefinedAlignment> there = refiner_.align(pairs);
  for (size_t i = 0; i < of.size(); ++i) out[of[i]].there = std::move(there[i]);
  // An older keyframe that drift has moved waits until a loop is closed (Loops): it would bend the window.
  const int newest = static_cast<int>(keyframes_.places().size());
  std::erase_if(out, [&](const Neighbour& n) {
    return n.keyframe->id < newest - size_ && judge_.confirmed(n.there) &&
           judge_.distance(n.there.T_10, T_WC.inverse() * n.keyframe->T_WC, *n.keyframe) > kMostDrift;
  });
  return out;
}

void Window::connect(Keyframe& k, std::span<Neighbour> neighbours) {
  std::vector<Pair> pairs;
  std::vector<Neighbour*> of;
  for (Neighbour& n : neighbours) {
    if (!judge_.confirmed(n.there)) continue;  // if one direction fails, so does the other in 95 of 100 cases
    of.push_back(&n);
    pairs.push_back(pair_of(k, n.keyframe->pixels.frame(camera_), n.keyframe->T_WC));
  }
  if (pairs.empty()) return;
  std::vector<RefinedAlignment> back = refiner_.align(pairs);
  for (size_t i = 0; i < of.size(); ++i) {
    Neighbour& n = *of[i];
    n.back = std::move(back[i]);
    n.keyframe->sightings[k.id] = n.there.features;
    if (judge_.confirmed(n.back)) k.sightings[n.keyframe->id] = n.back.features;
  }
}

/// The newest keyframes of the map are free, but not the oldest; those connected with them are fixed.
Window::Part Window::part() {
  std::map<int, const Keyframe*> all;
  for (const auto& [id, k] : keyframes_.all())
    if (k.map == keyframes_.current_map()) all[id] = &k;
  const int first_free = std::max(all.begin()->first + 1, static_cast<int>(keyframes_.places().size()) - size_);
  std::set<int> ids;
  for (const auto& [id, k] : all) {
    if (id >= first_free) ids.insert(id);
    if (id >= first_free && k->origin && keyframes_.find(k->origin->keyframe)) ids.insert(k->origin->keyframe);
    for (const auto& [seen_in, features] : k->sightings)
      if (id >= first_free || seen_in >= first_free) ids.insert({id, seen_in});
  }
  Part out;
  for (const int id : ids) {
    const Keyframe& k = *keyframes_.find(id);
    out.index[id] = static_cast<int>(out.frames.size());
    out.frames.push_back({k.T_WC, id < first_free, k.features.uv, k.features.inverse_depth, k.measured, k.sigma});
  }
  return out;
}

std::vector<BundleSighting> Window::sightings_of(const Part& part) {
  std::vector<BundleSighting> out;
  for (const auto& [id, at] : part.index)
    for (const auto& [seen_in, features] : keyframes_.find(id)->sightings) {
      const auto other = part.index.find(seen_in);
      if (other == part.index.end()) continue;
      for (size_t i = 0; i < features.size(); ++i)
        if (features[i].status == FeatureStatus::aligned)
          out.push_back({at, static_cast<int>(i), other->second, features[i].uv1, features[i].covariance});
    }
  return out;
}

std::vector<BundleEdge> Window::edges_of(const Part& part) {
  std::vector<BundleEdge> out;
  for (const auto& [id, at] : part.index) {
    const auto& origin = keyframes_.find(id)->origin;
    const auto from = origin ? part.index.find(origin->keyframe) : part.index.end();
    if (from == part.index.end()) continue;
    const Keyframe& k = *keyframes_.find(from->first);
    if (k.sightings.count(id) > 0) continue;  // which are more informative
    out.push_back({from->second, at, origin->T_CK, edge_covariance(*origin, k)});
  }
  return out;
}

void Window::adjust() {
  Part bundle = part();
  const auto sightings = sightings_of(bundle);
  const auto edges = edges_of(bundle);
  if (!internal::adjust(camera_, bundle.frames, sightings, edges, {.floor = kFloor}).usable) return;
  for (const auto& [id, at] : bundle.index) {
    const BundleFrame& frame = bundle.frames[static_cast<size_t>(at)];
    if (frame.fixed) continue;
    keyframes_.set_pose(id, frame.T_WC);
    Keyframe& k = *keyframes_.find(id);
    k.features.inverse_depth = frame.inverse_depth;
    keyframes_.prepare(k);
  }
}

}  // namespace iclk::internal
