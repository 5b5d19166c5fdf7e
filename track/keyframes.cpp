#include <iclk/track/keyframes.h>

#include <algorithm>
#include <cstring>

#include <iclk/shaders/shared.h>
#include <iclk/track/tracker.h>

namespace iclk {
namespace {

template <class T>
void copy_rows(const ImageView& image, std::vector<T>& to) {
  to.clear();
  if (image.empty()) return;
  const size_t row = static_cast<size_t>(image.width) * bytes_per_pixel(image.format);
  to.resize(row * static_cast<size_t>(image.height) / sizeof(T));
  for (int v = 0; v < image.height; ++v)
    std::memcpy(reinterpret_cast<uint8_t*>(to.data()) + row * static_cast<size_t>(v), image.row(v), row);
}

}  // namespace

void FramePixels::keep(const TrackFrame& frame) {
  time = frame.time;
  format = frame.image.format;
  copy_rows(frame.image, image);
  copy_rows(frame.depth, depth);
  copy_rows(frame.mask, mask);
}

TrackFrame FramePixels::frame(const Camera& camera) const {
  const auto view = [&](const auto& pixels, PixelFormat f) {
    return pixels.empty() ? ImageView{} : ImageView{pixels.data(), camera.width, camera.height, 0, f};
  };
  return {time, view(image, format), view(depth, PixelFormat::r32f), view(mask, PixelFormat::r8)};
}

double sharpness(const Map& grey) {
  const Map half = half_size(grey);
  double sum = 0;
  for (int v = 1; v + 1 < half.height; ++v)
    for (int u = 1; u + 1 < half.width; ++u) {
      const double gu = half.at(u + 1, v) - half.at(u - 1, v), gv = half.at(u, v + 1) - half.at(u, v - 1);
      sum += gu * gu + gv * gv;
    }
  return sum;
}

double mean_inverse_depth(const Keyframe& keyframe) {
  double sum = 0;
  for (const double q : keyframe.features.inverse_depth) sum += q;
  return sum / static_cast<double>(keyframe.features.inverse_depth.size());
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
    constexpr double kBorder = ICLK_PATCH / 2;
    if (!(uv.x() >= kBorder && uv.y() >= kBorder && uv.x() <= camera.width - 1 - kBorder &&
          uv.y() <= camera.height - 1 - kBorder))
      continue;
    ++visible;
    out.flow += (uv - keyframe.features.uv[i]).norm();
  }
  if (visible == 0) return out;
  out.flow /= visible;
  out.visible = static_cast<double>(visible) / static_cast<double>(keyframe.features.uv.size());
  return out;
}

Keyframe& Keyframes::add(double time, const SE3& T_WC) {
  int slot = size();
  if (size() == capacity_) {
    slot = held_.begin()->second.slot;
    const int gone = held_.begin()->first;
    held_.erase(held_.begin());
    for (auto& [id, keyframe] : held_) keyframe.sightings.erase(gone);
  }
  const int id = count();
  poses_.push_back(T_WC);
  Keyframe& keyframe = held_[id];
  keyframe.id = id;
  keyframe.slot = slot;
  keyframe.time = time;
  keyframe.T_WC = T_WC;
  return keyframe;
}

Keyframe* Keyframes::find(int id) {
  const auto at = held_.find(id);
  return at == held_.end() ? nullptr : &at->second;
}

void Keyframes::set_pose(int id, const SE3& T_WC) {
  poses_.at(static_cast<size_t>(id)) = T_WC;
  if (Keyframe* keyframe = find(id)) keyframe->T_WC = T_WC;
}

std::vector<int> Keyframes::best(const Camera& camera, const SE3& T_WC, size_t count, double least) const {
  struct Ranked {
    double score;
    int id;
  };
  std::vector<Ranked> ranked;
  for (const auto& [id, keyframe] : held_) {
    const Overlap o = overlap(camera, keyframe, T_WC);
    if (o.visible >= least) ranked.push_back({o.visible - o.flow / camera.width, id});
  }
  std::stable_sort(ranked.begin(), ranked.end(),
                   [](const Ranked& a, const Ranked& b) { return a.score != b.score ? a.score > b.score : a.id > b.id; });
  std::vector<int> ids;
  for (const Ranked& r : ranked)
    if (ids.size() < count) ids.push_back(r.id);
  return ids;
}

}  // namespace iclk
