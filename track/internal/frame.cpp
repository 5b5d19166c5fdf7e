#include <iclk/track/internal/frame.h>

#include <algorithm>
#include <cstring>

namespace iclk::internal {
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

/// Whether a difference at a pixel would read a hidden one.
bool hidden_about(const Map& map, int u, int v) {
  return std::max({map.at(u + 1, v), map.at(u - 1, v), map.at(u, v + 1), map.at(u, v - 1)}) > kHiddenFrom;
}

}  // namespace

void FramePixels::keep(const TrackFrame& frame) {
  time = frame.time;
  format = frame.image.format;
  copy_rows(frame.image, image);
  copy_rows(frame.depth, depth);
  copy_rows(frame.mask, mask);
  features = frame.features ? std::optional(*frame.features) : std::nullopt;
}

TrackFrame FramePixels::frame(const Camera& camera) const {
  const auto view = [&](const auto& pixels, PixelFormat f) {
    return pixels.empty() ? ImageView{} : ImageView{pixels.data(), camera.width, camera.height, 0, f};
  };
  return {time, view(image, format), view(depth, PixelFormat::r32f), view(mask, PixelFormat::r8),
          features ? &*features : nullptr};
}

void Frame::see(const TrackFrame& unrolled) {
  seen_ = unrolled;
  measured.reset();
  levels_.clear();
  hidden_.clear();
  sharpness_.reset();
}

const Pyramid& Frame::levels(int least) {
  levels_.reserve(kFeatureAlignmentLevels);  // references to levels stay valid
  if (levels_.empty()) levels_.push_back(grey_map(seen_.image));
  while (static_cast<int>(levels_.size()) < least) levels_.push_back(half_size(levels_.back()));
  return levels_;
}

double Frame::sharpness() {
  if (sharpness_) return *sharpness_;
  const Map& half = pyramid()[1];
  double sum = 0;
  for (int v = 1; v + 1 < half.height; ++v)
    for (int u = 1; u + 1 < half.width; ++u) {
      if (hidden_about(half, u, v)) continue;
      const double gu = half.at(u + 1, v) - half.at(u - 1, v), gv = half.at(u, v + 1) - half.at(u, v - 1);
      sum += gu * gu + gv * gv;
    }
  return sharpness_.emplace(sum);
}

const Pyramid& Frame::pyramid() {
  const Pyramid& plain = levels(kFeatureAlignmentLevels);
  if (seen_.mask.empty()) return plain;
  if (hidden_.empty()) {
    hidden_ = plain;
    hide(hidden_, seen_.mask);
  }
  return hidden_;
}

}  // namespace iclk::internal
