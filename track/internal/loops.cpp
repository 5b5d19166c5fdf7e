#include <iclk/track/internal/loops.h>

#include <algorithm>
#include <cmath>

#include <iclk/track/internal/bundle.h>

namespace iclk::internal {
namespace {

/// The drift that a loop may correct: a share of the way since then, and of the distance to what is seen; rad.
constexpr double kDrift = 0.05, kDriftAtRest = 0.05, kTurn = 0.2;
constexpr int kWaits = 10;             ///< keyframes, for which a loop waits for another one
constexpr double kLeastSigma = 0.002;  ///< of a motion: rad, and as a share of the distance to what is seen
constexpr int kIterations = 50;
constexpr size_t kMotions = 3;  ///< per keyframe, at most

BundleEdge with_floor(BundleEdge edge, const Keyframe& from) {
  const double z = 1 / mean_inverse_depth(from);
  edge.covariance.diagonal().head<3>().array() += kLeastSigma * kLeastSigma * z * z;
  edge.covariance.diagonal().tail<3>().array() += kLeastSigma * kLeastSigma;
  return edge;
}

}  // namespace

void Loops::follow(const Keyframe& k, std::span<const Neighbour> neighbours) {
  const size_t before = state.motions.size();
  for (const Neighbour& n : neighbours)
    if (judge_.confirmed(n.there) && state.motions.size() < before + kMotions)
      state.motions.push_back(with_floor({n.keyframe->id, k.id, n.there.T_10, n.there.covariance}, *n.keyframe));
  if (!k.origin || state.motions.size() > before) return;
  if (const Keyframe* from = keyframes_.find(k.origin->keyframe))
    state.motions.push_back(with_floor({from->id, k.id, k.origin->T_CK, edge_covariance(*k.origin, *from)}, *from));
}

/// What moves the newer keyframe, and all that hangs on it, to where the edge says, in the map.
SE3 Loops::correction(const BundleEdge& edge) const {
  const auto& places = keyframes_.places();
  return places[static_cast<size_t>(edge.from)].T_WC * edge.T_to_from.inverse() *
         places[static_cast<size_t>(edge.to)].T_WC.inverse();
}

bool Loops::plausible(const BundleEdge& edge) const {
  const Keyframe &from = keyframes_.open(edge.from), &to = *keyframes_.find(edge.to);
  const SE3 off = to.T_WC.inverse() * from.T_WC * edge.T_to_from.inverse();
  const double way = std::abs(to.way - from.way), z = 1 / mean_inverse_depth(to);
  return off.t.norm() <= kDrift * way + kDriftAtRest * z && off.angle() <= kTurn;
}

bool Loops::close(const BundleEdge& edge) {
  const BundleEdge whole = with_floor(edge, keyframes_.open(edge.from));
  std::vector<BundleEdge> before = std::move(state.waiting);
  state.waiting = {whole};
  if (before.empty() || edge.to - before[0].to > kWaits) return false;
  const Keyframe& k = *keyframes_.find(edge.to);
  const SE3 T_CW = k.T_WC.inverse();
  if (!judge_.agree(T_CW * correction(edge), T_CW * correction(before[0]), k)) return false;
  state.waiting.clear();
  state.loops.insert(state.loops.end(), {before[0], whole});
  return adjust(k.map, std::min({edge.from, edge.to, before[0].from}));
}

/// Moves the keyframes that are newer than `oldest`. Older ones, with which these are connected, stay: a loop does not show how
/// they drifted, and all that ever were would take longer and longer. The loops have their full weight at first, however far
/// the drift; then those that contradict the others lose theirs.
bool Loops::adjust(int map, int oldest) {
  const auto& places = keyframes_.places();
  std::vector<int> index(places.size(), -1);
  std::vector<BundleFrame> frames;
  const auto add = [&](int id, bool fixed) {
    if (places[static_cast<size_t>(id)].map != map || index[static_cast<size_t>(id)] >= 0) return;
    index[static_cast<size_t>(id)] = static_cast<int>(frames.size());
    BundleFrame& frame = frames.emplace_back();
    frame.T_WC = places[static_cast<size_t>(id)].T_WC;
    frame.fixed = fixed;
  };
  for (int id = oldest; id < static_cast<int>(places.size()); ++id) add(id, frames.empty());
  for (const auto* some : {&state.motions, &state.loops})
    for (const BundleEdge& edge : *some)
      if (std::max(edge.from, edge.to) > oldest) add(std::min(edge.from, edge.to), true);
  const std::vector<BundleEdge> edges = edges_of(index);
  for (const bool robust : {false, true}) {
    std::vector<BundleEdge> these = edges;
    for (BundleEdge& edge : these) edge.robust = edge.robust && robust;
    if (!internal::adjust(camera_, frames, {}, these, {.iterations = kIterations}).usable) return false;
  }
  for (size_t id = 0; id < index.size(); ++id)
    if (index[id] >= 0) keyframes_.set_pose(static_cast<int>(id), frames[static_cast<size_t>(index[id])].T_WC);
  return true;
}

/// `index`: of the keyframes in the graph, by id; else -1.
std::vector<BundleEdge> Loops::edges_of(const std::vector<int>& index) const {
  const auto& places = keyframes_.places();
  std::vector<BundleEdge> edges;
  for (const auto* some : {&state.motions, &state.loops})
    for (BundleEdge edge : *some) {
      const auto from = static_cast<size_t>(edge.from), to = static_cast<size_t>(edge.to);
      if (index[from] < 0 || index[to] < 0) continue;
      edge.robust = some == &state.loops;
      if (!edge.robust) edge.T_to_from = places[to].T_WC.inverse() * places[from].T_WC;  // as bundles left it
      edge.from = index[from];
      edge.to = index[to];
      edges.push_back(edge);
    }
  return edges;
}

}  // namespace iclk::internal
