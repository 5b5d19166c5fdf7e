#include <iclk/track/internal/place_finder.h>

#include <algorithm>
#include <utility>

namespace iclk::internal {
std::vector<int> PlaceFinder::in_other_maps(const Keyframe& k) {
  std::vector<int> all, ids;
  for (const auto& [id, other] : keyframes_.all())
    if (other.map != k.map) all.push_back(id);
  const size_t count = std::min(batch_, all.size());
  for (size_t i = 0; i < count; ++i) ids.push_back(all[(static_cast<size_t>(state.next_tried) + i) % all.size()]);
  state.next_tried += static_cast<int>(count);
  return ids;
}

std::optional<Link> PlaceFinder::find_in_other_maps(Keyframe& k, const TrackFrame& before, const SE3& T_WC) {
  const std::vector<int> ids = in_other_maps(k);
  if (ids.empty()) return {};
  std::vector<Pair> pairs;
  for (const int id : ids) {
    const Keyframe& other = *keyframes_.find(id);
    pairs.push_back(pair_of(other, k.pixels.frame(camera_), other.T_WC, true));
  }
  std::vector<RefinedAlignment> found = refiner_.align(pairs);
  size_t best = ids.size();
  for (size_t i = 0; i < ids.size(); ++i)
    if (judge_.confirmed(found[i]) && (best == ids.size() || found[i].inliers > found[best].inliers)) best = i;
  if (best == ids.size()) return {};
  return verify(k, *keyframes_.find(ids[best]), std::move(found[best]), before, T_WC.inverse() * k.T_WC);
}

std::optional<Link> PlaceFinder::verify(Keyframe& k, Keyframe& other, RefinedAlignment there, const TrackFrame& before,
                                        const SE3& T_before_k) {
  const SE3 T_k_other = there.T_10;
  const SE3 expected = other.T_WC * (T_before_k * T_k_other).inverse();  // T_WC of the frame before, in the other map
  const RefinedAlignment earlier = refiner_.align(pair_of(other, before, expected));
  if (!judge_.confirmed(earlier) || !judge_.agree(earlier.T_10, T_before_k * T_k_other, other)) return {};
  RefinedAlignment back = refiner_.align(pair_of(k, other.pixels.frame(camera_), k.T_WC * T_k_other));
  if (!judge_.confirmed(back) || !judge_.agree(back.T_10, T_k_other.inverse(), k)) return {};
  other.sightings[k.id] = std::move(there.features);
  k.sightings[other.id] = std::move(back.features);
  return Link{other.id, k.id, T_k_other, there.covariance};
}

}  // namespace iclk::internal
