#include <iclk/track/internal/place_finder.h>

#include <algorithm>
#include <utility>

namespace iclk::internal {
namespace {

constexpr size_t kAlike = 2, kNear = 2;  ///< candidates: by their signatures, and by their poses in the map
constexpr double kLeastLikeness = 0.13;  ///< of a candidate
constexpr double kLeastVisible = 0.3;    ///< of its features, by its pose in the map
static_assert(kAlike + kNear <= Keyframes::kOpen);

}  // namespace

std::vector<PlaceFinder::Candidate> PlaceFinder::candidates(const Keyframe& k) const {
  struct Ranked {
    double score;
    int id;
  };
  std::vector<Ranked> alike, near;
  keyframes_.each([&](const Keyframe& other) {
    if (other.map == k.map && (other.id > k.id - window_ || k.sightings.count(other.id) > 0)) return;
    if (const double l = likeness(k.signature, other.signature); l >= kLeastLikeness) alike.push_back({l, other.id});
    if (other.map != k.map) return;
    if (const double v = overlap(camera_, other, k.T_WC).visible; v >= kLeastVisible) near.push_back({v, other.id});
  });
  std::vector<Candidate> out;
  const auto add = [&](std::vector<Ranked>& ranked, size_t most, bool by_matching) {
    std::sort(ranked.begin(), ranked.end(),
              [](const Ranked& a, const Ranked& b) { return a.score != b.score ? a.score > b.score : a.id > b.id; });
    for (size_t i = 0; i < std::min(most, ranked.size()); ++i) out.push_back({ranked[i].id, by_matching});
  };
  add(near, kNear, false);
  add(alike, kAlike, true);
  return out;
}

std::optional<Link> PlaceFinder::find(Keyframe& k, const TrackFrame& before, const SE3& T_WC) {
  const std::vector<Candidate> tried = candidates(k);
  if (tried.empty()) return {};
  std::vector<Pair> pairs;
  std::vector<const Keyframe*> others;
  for (const Candidate& c : tried) {
    others.push_back(&keyframes_.open(c.id));
    const SE3& start = others.back()->map == k.map ? k.T_WC : others.back()->T_WC;
    pairs.push_back(pair_of(*others.back(), k.pixels.frame(camera_), start, c.by_matching));
  }
  std::vector<RefinedAlignment> found = refiner_.align(pairs);
  const auto best = judge_.only_place(others, found);
  if (!best) return {};
  return verify(k, *others[*best], std::move(found[*best]), before, T_WC.inverse() * k.T_WC);
}

std::optional<Link> PlaceFinder::verify(const Keyframe& k, const Keyframe& other, RefinedAlignment there,
                                        const TrackFrame& before, const SE3& T_before_k) {
  const SE3 T_k_other = there.T_10;
  const SE3 expected = other.T_WC * (T_before_k * T_k_other).inverse();  // T_WC of the frame before, in the other map
  const RefinedAlignment earlier = refiner_.align(pair_of(other, before, expected));
  if (!judge_.confirmed(earlier) || !judge_.agree(earlier.T_10, T_before_k * T_k_other, other)) return {};
  RefinedAlignment back = refiner_.align(pair_of(k, other.pixels.frame(camera_), k.T_WC * T_k_other));
  if (!judge_.confirmed(back) || !judge_.agree(back.T_10, T_k_other.inverse(), k)) return {};
  return Link{{other.id, k.id, T_k_other, there.covariance}, std::move(there.features), std::move(back.features)};
}

}  // namespace iclk::internal
