#include <algorithm>
#include <cmath>
#include <utility>

#include <iclk/track/internal/tracker_impl.h>

namespace iclk {
namespace {

/// A keyframe that shows so much more of a frame takes over: every other one adds an error of its own.
constexpr double kMoreVisible = 0.1;
/// Frames before that are this often repeated say nothing any more.
constexpr double kLongestPrediction = 5;

}  // namespace

SE3 Tracker::Impl::predict(double time) const {
  if (!velocity) return last->T_WC;
  const double factor = std::min((time - last->time) / velocity_seconds, kLongestPrediction);
  return last->T_WC * SE3::exp(factor * velocity->log());
}

Pair Tracker::Impl::pair_with(int id, const TrackFrame& frame, const SE3& T_WC, bool search) {
  const Keyframe& k = *keyframes.find(id);
  return {.reference = k.slot,
          .target = frame.image,
          .T_10 = T_WC.inverse() * k.T_WC,
          .prior = {},
          .search = search,
          .target_mask = frame.mask};
}

bool Tracker::Impl::confirmed(const RefinedAlignment& a) const {
  return a.converged() && a.refined && a.inliers >= options.min_inliers;
}

bool Tracker::Impl::credible(const RefinedAlignment& a, const Keyframe& k, const SE3& expected) const {
  if (!a.converged() || a.refined || a.iclk.correlation < options.weak_correlation) return false;
  // How far what the frame shows in its corners moved from where it was expected, at the keyframe's mean depth.
  const SE3 off = expected.inverse() * (k.T_WC * a.T_10.inverse());
  const double z = 1 / mean_inverse_depth(k), w = camera.width - 1, h = camera.height - 1;
  for (const Eigen::Vector2d& uv :
       {Eigen::Vector2d(0, 0), Eigen::Vector2d(w, 0), Eigen::Vector2d(0, h), Eigen::Vector2d(w, h)}) {
    const Eigen::Vector3d X = off * (camera.ray(uv) * z);
    if (!(X.z() > 0) || (camera.project(X) - uv).norm() > options.weak_motion * camera.width) return false;
  }
  return true;
}

void Tracker::Impl::consider(int id, const RefinedAlignment& a, const SE3& expected, std::optional<Found>& weak) {
  if (!credible(a, *keyframes.find(id), expected)) return;
  if (!weak || a.inliers > weak->alignment.inliers) weak = Found{id, a, false};
}

std::optional<Tracker::Impl::Found> Tracker::Impl::find_pose(const TrackFrame& frame, TrackResult& result) {
  if (!lost) {
    const SE3 expected = predict(frame.time);
    if (!keyframes.find(current)) current = keyframes.newest().id;
    RefinedAlignment a = refiner.align(pair_with(current, frame, expected, false));
    if (confirmed(a)) {
      const SE3 T_WC = keyframes.find(current)->T_WC * a.T_10.inverse();
      const std::vector<int> best = keyframes.best(camera, T_WC, 1, 0.3);
      if (best.empty() || best[0] == current) return Found{current, std::move(a)};
      const auto visible = [&](int id) { return overlap(camera, *keyframes.find(id), T_WC).visible; };
      if (visible(best[0]) < visible(current) + kMoreVisible) return Found{current, std::move(a)};
      RefinedAlignment b = refiner.align(pair_with(best[0], frame, T_WC, false));
      if (confirmed(b) && b.inliers > 0.8 * a.inliers) return Found{best[0], std::move(b)};
      return Found{current, std::move(a)};
    }
    result.searched = true;
    std::optional<Found> weak;
    consider(current, a, expected, weak);
    if (auto found = try_others(frame, expected, weak)) return found;
    if (weak && overlap(camera, *keyframes.find(weak->keyframe), expected).visible > 0.5) return weak;
    if (auto found = try_previous(frame, expected, weak, result)) return found;
    if (weak && keyframes.find(weak->keyframe)) return weak;  // it may have left for the frame before
  }
  result.searched = true;
  return relocalise(frame);
}

std::optional<Tracker::Impl::Found> Tracker::Impl::try_others(const TrackFrame& frame, const SE3& expected,
                                                              std::optional<Found>& weak) {
  std::vector<Pair> pairs;
  std::vector<int> ids;
  const auto add = [&](int id, const SE3& T_WC, bool search) {
    pairs.push_back(pair_with(id, frame, T_WC, search));
    ids.push_back(id);
  };
  for (const int id : keyframes.best(camera, expected, 3, 0.3))
    if (id != current) add(id, expected, false);
  if (!weak) {  // else the alignment came to an end that is as good as it gets with the current one
    if (velocity) add(current, last->T_WC, false);
    add(current, expected, true);
  }
  if (pairs.empty()) return {};
  std::vector<RefinedAlignment> found = refiner.align(pairs);
  std::optional<Found> best;
  for (size_t i = 0; i < found.size(); ++i) {
    consider(ids[i], found[i], expected, weak);
    if (confirmed(found[i]) && (!best || found[i].inliers > best->alignment.inliers)) best = Found{ids[i], std::move(found[i])};
  }
  return best;
}

std::optional<Tracker::Impl::Found> Tracker::Impl::try_previous(const TrackFrame& frame, const SE3& expected,
                                                                std::optional<Found>& weak, TrackResult& result) {
  // Nothing is more alike than the frame before.
  TrackResult made;
  if (keyframes.newest().time == previous.time) return {};
  FramePixels straight;
  if (rolls()) unroll(previous.frame(camera), camera, rows, previous_rate * options.readout, straight);
  const TrackFrame before = (rolls() ? straight : previous).frame(camera);
  if (!make_keyframe(before, last->T_WC, previous_origin, nullptr, made)) return {};
  result.before = TrackResult::Before{made.keyframe, before.time};
  for (const SE3& T_WC : {expected, last->T_WC}) {
    RefinedAlignment a = refiner.align(pair_with(current, frame, T_WC, false));
    if (confirmed(a)) return Found{current, std::move(a)};
    consider(current, a, expected, weak);
  }
  return {};
}

std::optional<Tracker::Impl::Found> Tracker::Impl::relocalise(const TrackFrame& frame) {
  // As many as a batch holds, so that a frame does not take for ever: those about the last pose, and others in turn.
  const size_t batch = std::min(static_cast<size_t>(aligner.plan().max_pairs), static_cast<size_t>(keyframes.size()));
  std::vector<int> ids = keyframes.best(camera, last->T_WC, batch / 2, 0.2);
  std::vector<int> others;
  for (const auto& [id, k] : keyframes.all())
    if (std::find(ids.begin(), ids.end(), id) == ids.end()) others.push_back(id);
  for (size_t i = 0; ids.size() < batch; ++i) ids.push_back(others[(static_cast<size_t>(next_tried) + i) % others.size()]);
  next_tried += static_cast<int>(batch);
  std::vector<Pair> pairs;
  for (const int id : ids) pairs.push_back(pair_with(id, frame, last->T_WC, true));
  std::vector<RefinedAlignment> found = refiner.align(pairs);
  std::optional<Found> best;
  for (size_t i = 0; i < found.size(); ++i)
    if (confirmed(found[i]) && (!best || found[i].inliers > best->alignment.inliers)) best = Found{ids[i], std::move(found[i])};
  return best;
}

}  // namespace iclk
