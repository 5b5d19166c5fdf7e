#include <iclk/track/internal/unroll.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <type_traits>
#include <vector>

#include <Eigen/Geometry>

#include <iclk/align/common/each.h>

namespace iclk::internal {
namespace {

/// The source is interpolated between nodes of a grid. Over so few pixels, the motion by a turning camera is linear.
constexpr int kCell = 16;
constexpr int kRounds = 3;  // iterations: the row of the source, and the turn of the camera at that row
constexpr double kLeastZ = 1e-3;

Eigen::Matrix3d turned(const Eigen::Vector3d& phi) {
  return SE3::exp((Vector6d() << Eigen::Vector3d::Zero(), phi).finished()).R;
}

/// The position in the frame of a pixel of the global shutter camera, and the ratio of their depths.
struct Source {
  Eigen::Vector2f uv;
  float depth_ratio = 1;
};

Source source_of(const Camera& camera, const RowTimes& rows, const Eigen::Vector3d& turn, const Eigen::Vector2d& uv) {
  const Eigen::Vector3d ray = camera.ray(uv);
  Eigen::Vector2d at = uv;
  double z = 1;
  for (int round = 0; round < kRounds; ++round) {
    const Eigen::Vector3d p = turned(-turn * rows.at(at)) * ray;
    if (!(p.z() > kLeastZ)) return {Eigen::Vector2f::Constant(-1e6f), 1};
    at = camera.project(p);
    z = p.z();
  }
  return {at.cast<float>(), static_cast<float>(z)};
}

/// source_of() for all pixels.
class Sources {
 public:
  Sources(const Camera& camera, const RowTimes& times, const Eigen::Vector3d& turn) : columns_((camera.width - 1) / kCell + 2) {
    const int rows = (camera.height - 1) / kCell + 2;
    nodes_.reserve(static_cast<size_t>(columns_) * static_cast<size_t>(rows));
    for (int j = 0; j < rows; ++j)
      for (int i = 0; i < columns_; ++i) nodes_.push_back(source_of(camera, times, turn, Eigen::Vector2d(i, j) * kCell));
  }
  /// One row of pixels.
  void row(int v, std::vector<Source>& out) const {
    const float b = static_cast<float>(v % kCell) / kCell;
    const Source* above = &nodes_[static_cast<size_t>(v / kCell) * static_cast<size_t>(columns_)];
    const Source* below = above + columns_;
    const auto node = [&](size_t i) {
      return Eigen::Vector3f((1 - b) * above[i].uv.x() + b * below[i].uv.x(), (1 - b) * above[i].uv.y() + b * below[i].uv.y(),
                             (1 - b) * above[i].depth_ratio + b * below[i].depth_ratio);
    };
    Eigen::Vector3f left = node(0);
    for (size_t first = 0, i = 1; first < out.size(); first += kCell, ++i) {
      const Eigen::Vector3f right = node(i), step = (right - left) / kCell;
      const size_t end = std::min(first + kCell, out.size());
      for (size_t u = first; u < end; ++u) {
        const Eigen::Vector3f at = left + static_cast<float>(u - first) * step;
        out[u] = {at.head<2>(), at.z()};
      }
      left = right;
    }
  }

 private:
  int columns_;
  std::vector<Source> nodes_;
};

template <class T, int kChannels>
void sample_row(const ImageView& image, const std::vector<Source>& sources, T* out) {
  for (const Source& s : sources) {
    const float u = std::clamp(s.uv.x(), 0.0f, static_cast<float>(image.width - 1));
    const float v = std::clamp(s.uv.y(), 0.0f, static_cast<float>(image.height - 1));
    const int u0 = static_cast<int>(u), v0 = static_cast<int>(v);
    const int u1 = std::min(u0 + 1, image.width - 1) * kChannels, v1 = std::min(v0 + 1, image.height - 1);
    const T *above = reinterpret_cast<const T*>(image.row(v0)), *below = reinterpret_cast<const T*>(image.row(v1));
    const float a = u - static_cast<float>(u0), b = v - static_cast<float>(v0);
    const float w[4] = {(1 - b) * (1 - a), (1 - b) * a, b * (1 - a), b * a};
    for (int c = 0; c < kChannels; ++c) {
      const auto at = [&](const T* row, int x) { return static_cast<float>(row[x + c]); };
      const float value =
          w[0] * at(above, u0 * kChannels) + w[1] * at(above, u1) + w[2] * at(below, u0 * kChannels) + w[3] * at(below, u1);
      *out++ = std::is_floating_point_v<T> ? static_cast<T>(value) : static_cast<T>(value + 0.5f);
    }
  }
}

template <class T>
void sample_row(const ImageView& image, const std::vector<Source>& sources, uint8_t* out) {
  T* to = reinterpret_cast<T*>(out);
  switch (channels(image.format)) {
    case 1: return sample_row<T, 1>(image, sources, to);
    case 3: return sample_row<T, 3>(image, sources, to);
    case 4: return sample_row<T, 4>(image, sources, to);
  }
}

/// The nearest integer of a value within 2^20 of zero. std::floor would be a library call.
int nearest(float x) {
  constexpr int kAway = 1 << 20;
  return static_cast<int>(static_cast<double>(x) + 0.5 + kAway) - kAway;
}

/// The features as the global shutter camera would have seen them.
Features unrolled(const Features& read, const Camera& camera, const RowTimes& rows, const Eigen::Vector3d& turn) {
  Features out = read;
  for (size_t i = 0; i < out.uv.size(); ++i) {
    if (!out.uv[i].allFinite()) continue;  // it is not used
    const Eigen::Vector3d p = turned(turn * rows.at(out.uv[i])) * camera.ray(out.uv[i]);
    out.uv[i] = p.z() > kLeastZ ? camera.project(p) : Eigen::Vector2d::Constant(-1e6);
    out.inverse_depth[i] /= p.z();
    if (!out.inverse_depth_sigma.empty()) out.inverse_depth_sigma[i] /= std::max(p.z(), kLeastZ);
  }
  return out;
}

bool inside(const ImageView& image, int u, int v) { return u >= 0 && v >= 0 && u < image.width && v < image.height; }

}  // namespace

void unroll(const TrackFrame& frame, const Camera& camera, const RowTimes& rows, const Eigen::Vector3d& turn,
            FramePixels& out) {
  const ImageView& image = frame.image;
  const size_t width = static_cast<size_t>(image.width), pixels = width * static_cast<size_t>(image.height);
  const size_t bytes = bytes_per_pixel(image.format), sample = bytes / static_cast<size_t>(channels(image.format));
  out.time = frame.time;
  out.format = image.format;
  out.image.resize(pixels * bytes);
  out.mask.resize(pixels);
  out.depth.resize(frame.depth.empty() ? 0 : pixels);
  out.features = frame.features ? std::optional(unrolled(*frame.features, camera, rows, turn)) : std::nullopt;
  const Sources sources(camera, rows, turn);
  const auto unroll_row = [&](int v, std::vector<Source>& row) {
    const size_t at = static_cast<size_t>(v) * width;
    sources.row(v, row);
    uint8_t* to = &out.image[at * bytes];
    if (sample == 1)
      sample_row<uint8_t>(image, row, to);
    else if (sample == 2)
      sample_row<uint16_t>(image, row, to);
    else
      sample_row<float>(image, row, to);
    for (size_t u = 0; u < width; ++u) {
      const int x = nearest(row[u].uv.x()), y = nearest(row[u].uv.y());
      const bool seen = inside(image, x, y);
      out.mask[at + u] = seen && (frame.mask.empty() || frame.mask.row(y)[x]) ? 255 : 0;
      if (!out.depth.empty())
        out.depth[at + u] = seen ? reinterpret_cast<const float*>(frame.depth.row(y))[x] / row[u].depth_ratio : 0;
    }
  };
  constexpr int kBand = 64;  // rows
  for_each_of(static_cast<size_t>((image.height + kBand - 1) / kBand), 0, [&](size_t band) {
    std::vector<Source> row(width);
    const int first = static_cast<int>(band) * kBand;
    for (int v = first; v < std::min(first + kBand, image.height); ++v) unroll_row(v, row);
  });
}

Eigen::Vector2d unrolled_anew(const Camera& camera, const RowTimes& rows, const Eigen::Vector3d& from,
                              const Eigen::Vector3d& to, const Eigen::Vector2d& uv) {
  const Eigen::Vector2d read = source_of(camera, rows, from, uv).uv.cast<double>();
  return camera.project(turned(to * rows.at(read)) * camera.ray(read));
}

}  // namespace iclk::internal
