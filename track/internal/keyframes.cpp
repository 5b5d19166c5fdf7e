#include <iclk/track/internal/keyframes.h>

#include <algorithm>
#include <cmath>

#include <iclk/shaders/shared.h>

namespace iclk::internal {
namespace {

/// The sigma of an unconfirmed pose: rad, and the equivalent translation at the mean depth.
constexpr double kWeakSigma = 0.03;

}  // namespace

double mean_inverse_depth(const Keyframe& keyframe) {
  double sum = 0;
  for (const double q : keyframe.features.inverse_depth) sum += q;
  return sum / static_cast<double>(keyframe.features.inverse_depth.size());
}

bool inside(const Camera& camera, const Eigen::Vector2d& uv, double border) {
  return uv.x() >= border && uv.y() >= border && uv.x() <= camera.width - 1 - border && uv.y() <= camera.height - 1 - border;
}

Matrix6d edge_covariance(const TrackResult::Origin& origin, const Keyframe& from) {
  if (origin.confirmed) return origin.covariance;
  const double distance = 1 / mean_inverse_depth(from);
  Vector6d sigma;
  sigma << Eigen::Vector3d::Constant(kWeakSigma * distance), Eigen::Vector3d::Constant(kWeakSigma);
  return sigma.cwiseAbs2().asDiagonal();
}

double corner_motion(const Camera& camera, const SE3& off, double z) {
  const double w = camera.width - 1, h = camera.height - 1;
  double most = 0;
  for (const Eigen::Vector2d& uv :
       {Eigen::Vector2d(0, 0), Eigen::Vector2d(w, 0), Eigen::Vector2d(0, h), Eigen::Vector2d(w, h)}) {
    const Eigen::Vector3d X = off * (camera.ray(uv) * z);
    if (!(X.z() > 0)) return INFINITY;
    most = std::max(most, (camera.project(X) - uv).norm());
  }
  return most;
}

Overlap overlap(const Camera& camera, const Keyframe& keyframe, const SE3& T_WC) {
  const SE3 T_10 = T_WC.inverse() * keyframe.T_WC;
  Overlap out;
  int visible = 0;
  for (size_t i = 0; i < keyframe.features.uv.size(); ++i) {
    const double q = keyframe.features.inverse_depth[i];
    const Eigen::Vector3d p = T_10.R * camera.ray(keyframe.features.uv[i]) + q * T_10.t;
    if (!(p.z() > 1e-3)) continue;
    const Eigen::Vector2d uv = camera.project(p);
    if (!inside(camera, uv, ICLK_PATCH / 2)) continue;
    ++visible;
    out.flow += (uv - keyframe.features.uv[i]).norm();
  }
  if (visible == 0) return out;
  out.flow /= visible;
  out.visible = static_cast<double>(visible) / static_cast<double>(keyframe.features.uv.size());
  return out;
}

Pair pair_of(const Keyframe& keyframe, const TrackFrame& frame, const SE3& T_WC, bool search) {
  return {.reference = keyframe.slot,
          .target = frame.image,
          .T_10 = T_WC.inverse() * keyframe.T_WC,
          .prior = {},
          .search = search,
          .target_mask = frame.mask};
}

namespace {

/// The keyframe that was not used for longest.
auto unused(const std::map<int, Keyframe>& keyframes) {
  return std::min_element(keyframes.begin(), keyframes.end(),
                          [](const auto& a, const auto& b) { return a.second.used < b.second.used; });
}

}  // namespace

int Keyframes::leaving() const {
  if (size() < capacity_) return -1;
  return unused(held_)->first;
}

int Keyframes::free_slot() {
  const int gone = leaving();
  if (gone < 0) return size();
  Keyframe& k = held_.at(gone);
  const int slot = k.slot;
  archive(std::move(k));
  held_.erase(gone);
  for (auto& [id, keyframe] : held_) keyframe.sightings.erase(gone);
  return slot;
}

void Keyframes::archive(Keyframe&& k) {
  k.sightings.clear();
  k.seeds.clear();
  archived_[k.id] = std::move(k);
  while (archived_.size() > archive_) archived_.erase(unused(archived_));
}

Keyframe& Keyframes::add(double time, const SE3& T_WC) {
  const int slot = free_slot();
  const auto id = static_cast<int>(places_.size());
  places_.push_back({T_WC, map_});
  Keyframe& keyframe = held_[id];
  keyframe.id = id;
  keyframe.slot = slot;
  keyframe.map = map_;
  keyframe.time = time;
  keyframe.used = clock;
  keyframe.T_WC = T_WC;
  return keyframe;
}

Keyframe& Keyframes::open(int id) {
  if (Keyframe* held = find(id)) return *held;
  Keyframe& k = archived_.at(id);
  k.slot = capacity_ + opened_++ % kOpen;
  prepare(k);
  return k;
}

Keyframe& Keyframes::hold(int id) {
  if (Keyframe* held = find(id)) return *held;
  auto kept = archived_.extract(id);  // before another one is archived
  const int slot = free_slot();
  Keyframe& k = held_[id] = std::move(kept.mapped());
  k.slot = slot;
  k.used = clock;
  prepare(k);
  return k;
}

void Keyframes::hold_next(const Keyframe& k, int window) {
  std::vector<int> ids;
  for (const auto& [id, features] : k.sightings)
    if (id <= k.id - window) ids.insert(ids.end(), {id - 1, id + 1});
  for (const int id : ids)
    if (const auto at = archived_.find(id); at != archived_.end() && at->second.map == k.map) hold(id);
}

void Keyframes::prepare(const Keyframe& k) {
  aligner_.set_reference(
      k.slot, {.image = k.pixels.frame(camera_).image, .camera = camera_, .features = k.features, .inverse_depth = {}});
}

void Keyframes::restore(std::map<int, Keyframe> held, std::map<int, Keyframe> archived, std::vector<Place> places, int map) {
  held_ = std::move(held);
  archived_ = std::move(archived);
  places_ = std::move(places);
  map_ = map;
}

void Keyframes::join(int from, int into, const SE3& T_into_from) {
  for (Place& place : places_)
    if (place.map == from) place = {T_into_from * place.T_WC, into};
  for (auto* some : {&held_, &archived_})
    for (auto& [id, keyframe] : *some) {
      keyframe.map = places_[static_cast<size_t>(id)].map;
      keyframe.T_WC = places_[static_cast<size_t>(id)].T_WC;
    }
  if (map_ == from) map_ = into;
}

Keyframe* Keyframes::find(int id) {
  const auto at = held_.find(id);
  return at == held_.end() ? nullptr : &at->second;
}

Keyframe& Keyframes::newest_of_map() {
  const auto at = std::find_if(held_.rbegin(), held_.rend(), [&](const auto& held) { return held.second.map == map_; });
  return at == held_.rend() ? newest() : at->second;
}

void Keyframes::set_pose(int id, const SE3& T_WC) {
  places_.at(static_cast<size_t>(id)).T_WC = T_WC;
  for (auto* some : {&held_, &archived_})
    if (const auto at = some->find(id); at != some->end()) at->second.T_WC = T_WC;
}

std::vector<int> Keyframes::best(const SE3& T_WC, size_t count, double least) const {
  struct Ranked {
    double score;
    int id;
  };
  std::vector<Ranked> ranked;
  for (const auto& [id, keyframe] : held_) {
    if (keyframe.map != map_) continue;
    const Overlap o = overlap(camera_, keyframe, T_WC);
    if (o.visible >= least) ranked.push_back({o.visible - o.flow / camera_.width, id});
  }
  std::stable_sort(ranked.begin(), ranked.end(),
                   [](const Ranked& a, const Ranked& b) { return a.score != b.score ? a.score > b.score : a.id > b.id; });
  std::vector<int> ids;
  for (const Ranked& r : ranked)
    if (ids.size() < count) ids.push_back(r.id);
  return ids;
}

}  // namespace iclk::internal
