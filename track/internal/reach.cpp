#include <iclk/track/internal/reach.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include <iclk/track/internal/bundle.h>

namespace iclk::internal {
namespace {

constexpr double kFaster = 3;     ///< than the largest speed of late
constexpr double kRemember = 10;  ///< s; the time in which a speed counts for a third
constexpr double kAtRest = 0.5;   ///< of the distance to what is seen: at once, and per second of a camera that stood
constexpr double kDrift = 0.05;   ///< of the way

}  // namespace

void Reach::move(double distance, double seconds) {
  state.speed = std::max(distance / seconds, state.speed * std::exp(-seconds / kRemember));
}

void Reach::leave(int keyframe, double distance, double time, double way) {
  state.breaks.push_back({.from = keyframe, .left = time, .way = way, .away = distance});
}

void Reach::arrive(const Keyframe& k, double distance, double time) {
  if (!lost()) return;
  Break& b = state.breaks.back();
  b.to = k.id;
  b.beyond = distance;
  b.most = most(k, time - b.left);
  std::erase_if(state.breaks, [&](const Break& each) { return map_of(each.from) == map_of(each.to); });
}

void Reach::move_freely() {
  if (lost()) state.breaks.pop_back();
  for (Break& b : state.breaks) b.left = -std::numeric_limits<double>::infinity();
}

bool Reach::allows(const Keyframe& k, const SE3& T_WC, double time) const {
  if (lost() && state.repeats && map_of(state.breaks.back().from) != k.map) return false;
  const auto b = std::find_if(state.breaks.rbegin(), state.breaks.rend(),
                              [&](const Break& each) { return map_of(each.from) == k.map; });  // when it left the map
  if (b == state.breaks.rend()) return true;
  const double distance = (T_WC.t - keyframes_.places()[static_cast<size_t>(b->from)].T_WC.t).norm();
  return distance <= b->away + drift(k, *b) + most(k, time - b->left);
}

bool Reach::allows(const Keyframe& from, const Keyframe& to, const BundleEdge& link) {
  const SE3 T_from_to = from.T_WC * (to.T_WC * link.T_to_from).inverse();  // of the maps
  const auto place = [&](int keyframe) -> Eigen::Vector3d {
    const Eigen::Vector3d& t = keyframes_.places()[static_cast<size_t>(keyframe)].T_WC.t;
    return map_of(keyframe) == to.map ? T_from_to * t : t;
  };
  bool known = false, possible = true;
  for (const Break& b : state.breaks) {
    if (b.to < 0 || !joins(b, from.map, to.map)) continue;
    known = true;
    const double distance = (place(b.from) - place(b.to)).norm();
    possible &= distance <= b.away + b.beyond + b.most + drift(from, b) + drift(to, b);
  }
  state.repeats |= !possible;
  return possible && (known || !state.repeats);
}

bool Reach::joins(const Break& b, int map, int other) const {
  const int from = map_of(b.from), to = map_of(b.to);
  return (from == map && to == other) || (from == other && to == map);
}

int Reach::map_of(int keyframe) const { return keyframes_.places()[static_cast<size_t>(keyframe)].map; }

double Reach::most(const Keyframe& k, double seconds) const {
  const double z = 1 / mean_inverse_depth(k);
  return kAtRest * z + std::max(kFaster * state.speed, kAtRest * z) * seconds;
}

double Reach::drift(const Keyframe& k, const Break& b) const { return kDrift * std::abs(k.way - b.way); }

}  // namespace iclk::internal
