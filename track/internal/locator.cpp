#include <iclk/track/internal/locator.h>

#include <algorithm>
#include <utility>

#include <iclk/shaders/shared.h>
#include <iclk/track/internal/detector.h>

namespace iclk::internal {
namespace {

/// Another keyframe replaces the current one if it shows this much more of the frame and finds most of the features. Each
/// change of the keyframe adds an error.
constexpr double kMoreVisible = 0.1, kMostInliers = 0.8;
/// The least visible share of features of a keyframe that is tried: at the expected pose, and at the pose of a lost frame.
constexpr double kLeastVisible = 0.3, kLeastVisibleLost = 0.2;
constexpr size_t kOthers = 3;
constexpr int kSignatureFeatures = 100;

}  // namespace

std::optional<Found> Locator::follow(const TrackFrame& frame, Search& search) {
  if (!keyframes_.find(state.current)) state.current = keyframes_.newest_of_map().id;
  const Keyframe& current = *keyframes_.find(state.current);
  RefinedAlignment a = refiner_.align(pair_of(current, frame, search.expected));
  if (!judge_.confirmed(a)) {
    consider(current.id, a, search);
    return {};
  }
  const SE3 T_WC = current.T_WC * a.T_10.inverse();
  const std::vector<int> best = keyframes_.best(T_WC, 1, kLeastVisible);
  if (best.empty() || best[0] == current.id) return Found{current.id, std::move(a)};
  const Keyframe& other = *keyframes_.find(best[0]);
  if (overlap(camera_, other, T_WC).visible < overlap(camera_, current, T_WC).visible + kMoreVisible)
    return Found{current.id, std::move(a)};
  RefinedAlignment b = refiner_.align(pair_of(other, frame, T_WC));
  if (judge_.confirmed(b) && b.inliers > kMostInliers * a.inliers) return Found{other.id, std::move(b)};
  return Found{current.id, std::move(a)};
}

std::optional<Found> Locator::try_others(const TrackFrame& frame, const Motion& motion, Search& search) {
  std::vector<Pair> pairs;
  std::vector<int> ids;
  const auto add = [&](int id, const SE3& T_WC, bool by_matching) {
    pairs.push_back(pair_of(*keyframes_.find(id), frame, T_WC, by_matching));
    ids.push_back(id);
  };
  for (const int id : keyframes_.best(search.expected, kOthers, kLeastVisible))
    if (id != state.current) add(id, search.expected, false);
  if (!search.weak) {  // else the current keyframe has already given its best pose
    if (motion.velocity) add(state.current, motion.last->T_WC, false);
    add(state.current, search.expected, true);
  }
  if (pairs.empty()) return {};
  std::vector<RefinedAlignment> found = refiner_.align(pairs);
  for (size_t i = 0; i < found.size(); ++i) consider(ids[i], found[i], search);
  return best_of(ids, found);
}

std::optional<Found> Locator::credible(const Search& search, double visible) {
  if (!search.weak) return {};
  const Keyframe* k = keyframes_.find(search.weak->keyframe);  // a new keyframe may have replaced it
  return k && overlap(camera_, *k, search.expected).visible > visible ? search.weak : std::nullopt;
}

std::optional<Found> Locator::try_current(const TrackFrame& frame, const Motion& motion, Search& search) {
  for (const SE3& T_WC : {search.expected, motion.last->T_WC}) {
    RefinedAlignment a = unbending_.align(pair_of(*keyframes_.find(state.current), frame, T_WC));
    if (judge_.confirmed(a)) return Found{state.current, std::move(a)};
    consider(state.current, a, search);
  }
  return {};
}

std::optional<Found> Locator::relocalise(Frame& frame, const SE3& last) {
  const Signature signature =
      signature_of(frame.grey(), detect_seeds(frame.grey(), {}, frame.seen().mask, {}, kSignatureFeatures, ICLK_PATCH));
  if (signature.empty()) return {};  // without texture
  std::vector<Pair> pairs;
  std::vector<const Keyframe*> tried;
  for (const int id : lost_among(signature, last)) {
    tried.push_back(&keyframes_.open(id));
    const bool here = tried.back()->map == keyframes_.current_map();
    pairs.push_back(pair_of(*tried.back(), frame.seen(), here ? last : tried.back()->T_WC, true));
  }
  std::vector<RefinedAlignment> found = refiner_.align(pairs);
  for (size_t i = found.size(); i-- > 0;)
    if (!reach_.allows(*tried[i], tried[i]->T_WC * found[i].T_10.inverse(), frame.given.time)) {
      tried.erase(tried.begin() + static_cast<std::ptrdiff_t>(i));
      found.erase(found.begin() + static_cast<std::ptrdiff_t>(i));
    }
  const auto best = judge_.only_place(tried, found);
  if (!best) return {};
  return Found{keyframes_.hold(tried[*best]->id).id, std::move(found[*best])};
}

std::vector<int> Locator::lost_among(const Signature& signature, const SE3& last) {
  std::vector<int> ids = keyframes_.best(last, batch_ / 2, kLeastVisibleLost);
  std::vector<std::pair<double, int>> others;
  keyframes_.each([&](const Keyframe& k) {
    if (std::find(ids.begin(), ids.end(), k.id) == ids.end()) others.emplace_back(-likeness(signature, k.signature), -k.id);
  });
  std::sort(others.begin(), others.end());
  int archived = 0;
  for (size_t i = 0; i < others.size() && ids.size() < batch_; ++i)
    if (keyframes_.find(-others[i].second) || archived++ < Keyframes::kOpen) ids.push_back(-others[i].second);
  return ids;
}

void Locator::consider(int id, const RefinedAlignment& a, Search& search) {
  if (!judge_.credible(a, *keyframes_.find(id), search.expected)) return;
  if (!search.weak || a.inliers > search.weak->alignment.inliers) search.weak = Found{id, a, false};
}

std::optional<Found> Locator::best_of(std::span<const int> ids, std::span<RefinedAlignment> found) {
  std::optional<Found> best;
  for (size_t i = 0; i < found.size(); ++i)
    if (judge_.confirmed(found[i]) && (!best || found[i].inliers > best->alignment.inliers))
      best = Found{ids[i], std::move(found[i])};
  return best;
}

}  // namespace iclk::internal
