#include <iclk/render/internal/windows.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace iclk {
namespace {

/// Texels around a window for filter taps outside the footprint of a pixel.
constexpr int kMargin = 18;

/// Columns (or rows) of level 0 between two coordinates.
struct Range {
  int first, last;
};

Range range(double low, double high, int size) {
  const double limit = size - 1;
  return {static_cast<int>(std::clamp(std::floor(low), 0.0, limit)), static_cast<int>(std::clamp(std::ceil(high), 0.0, limit))};
}

void add(Windows& windows, int level, const Range& x, const Range& y) {
  windows.levels[static_cast<size_t>(level)] = {
      x.first, y.first, x.last - x.first + 1, y.last - y.first + 1, static_cast<int>(windows.elements), 0, 0, 0};
  windows.elements += static_cast<uint64_t>(x.last - x.first + 1) * static_cast<uint64_t>(y.last - y.first + 1);
}

}  // namespace

std::optional<PixelBox> pinhole_box(const Camera& camera, const Lens& lens, const PixelRect& pixels) {
  if (lens.empty())
    return PixelBox{pixels.x - 0.5, pixels.y - 0.5, pixels.x - 0.5 + pixels.width, pixels.y - 0.5 + pixels.height};
  constexpr double inf = std::numeric_limits<double>::infinity();
  constexpr double beyond = 0.75;  // of the distance to a neighbour; a pixel ends at half of it
  PixelBox box{inf, inf, -inf, -inf};
  const auto take = [&](const Eigen::Vector2d& at) {
    box = {std::min(box.u0, at.x()), std::min(box.v0, at.y()), std::max(box.u1, at.x()), std::max(box.v1, at.y())};
  };
  const Eigen::Vector2d none = Eigen::Vector2d::Constant(std::nan(""));  // outside the domain of the lens
  std::vector<Eigen::Vector2d> above(static_cast<size_t>(pixels.width) + 2, none);
  const auto inside = [&](int u, int v) {
    return u >= pixels.x && v >= pixels.y && u < pixels.x + pixels.width && v < pixels.y + pixels.height;
  };
  // One pixel more on every side, so that there is a neighbour behind each edge.
  for (int v = pixels.y - 1; v <= pixels.y + pixels.height; ++v) {
    Eigen::Vector2d left = none;
    for (int u = pixels.x - 1; u <= pixels.x + pixels.width; ++u) {
      Eigen::Vector2d& up = above[static_cast<size_t>(u - pixels.x + 1)];
      const Eigen::Vector2d at = pinhole_pixel(camera, lens, {u, v}).value_or(none);
      const auto edges = [&](const Eigen::Vector2d& neighbour, bool neighbour_inside) {
        const Eigen::Vector2d step = beyond * (at - neighbour);
        if (!step.allFinite()) return;
        if (inside(u, v)) take(at + step), take(at - step);
        if (neighbour_inside) take(neighbour + step), take(neighbour - step);
      };
      edges(left, inside(u - 1, v));
      edges(up, inside(u, v - 1));
      if (at.allFinite() && inside(u, v)) take(at);
      left = up = at;
    }
  }
  if (box.u0 > box.u1) return {};
  return box;
}

MapBox footprint(const Camera& camera, const SE3& T_WC, const PixelBox& seen, double lowest, double highest,
                 const MapBox& extent) {
  // The depth of a point is at most its distance.
  const auto farthest = [](double at, double a, double b) { return std::max(std::abs(a - at), std::abs(b - at)); };
  const Eigen::Vector3d& C = T_WC.t;
  const double far = Eigen::Vector3d(farthest(C.x(), extent.left, extent.right), farthest(C.y(), extent.bottom, extent.top),
                                     farthest(C.z(), lowest, highest))
                         .norm();
  const std::array<Eigen::Vector2d, 4> corners = {
      Eigen::Vector2d(seen.u0, seen.v0), {seen.u1, seen.v0}, {seen.u1, seen.v1}, {seen.u0, seen.v1}};
  std::array<Eigen::Vector3d, 4> ends;
  for (size_t i = 0; i < 4; ++i) ends[i] = C + far * (T_WC.R * camera.ray(corners[i]));

  constexpr double inf = std::numeric_limits<double>::infinity();
  MapBox box{inf, inf, -inf, -inf};
  const auto take = [&](const Eigen::Vector3d& X) {
    box = {std::min(box.left, X.x()), std::min(box.bottom, X.y()), std::max(box.right, X.x()), std::max(box.top, X.y())};
  };
  const auto edge = [&](const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
    for (const Eigen::Vector3d& X : {a, b})
      if (X.z() >= lowest && X.z() <= highest) take(X);
    for (const double z : {lowest, highest})
      if ((a.z() - z) * (b.z() - z) < 0) take(a + (b - a) * ((z - a.z()) / (b.z() - a.z())));
  };
  for (size_t i = 0; i < 4; ++i) {
    edge(C, ends[i]);
    edge(ends[i], ends[(i + 1) % 4]);
  }
  return box.intersection(extent);
}

template <typename T>
Windows whole(const std::vector<RasterLevel<T>>& levels) {
  Windows windows;
  for (size_t l = 0; l < levels.size(); ++l)
    add(windows, static_cast<int>(l), {0, levels[l].width - 1}, {0, levels[l].height - 1});
  return windows;
}

Windows relief_windows(const std::vector<RasterLevel<float>>& levels, const Grid& grid, const MapBox& box) {
  const Eigen::Vector2d low = grid.pixel(box.left, box.top), high = grid.pixel(box.right, box.bottom);
  const Range x = range(low.x() - 1, high.x() + 1, levels[1].width), y = range(low.y() - 1, high.y() + 1, levels[1].height);
  Windows windows;
  add(windows, 0, {x.first, x.last + 1}, {y.first, y.last + 1});
  for (int k = 0; k + 1 < static_cast<int>(levels.size()); ++k)
    add(windows, k + 1, {x.first >> k, x.last >> k}, {y.first >> k, y.last >> k});
  return windows;
}

Windows mosaic_windows(const std::vector<RasterLevel<uint32_t>>& levels, const Grid& grid, const MapBox& box, int finest) {
  const Eigen::Vector2d low = grid.pixel(box.left, box.top), high = grid.pixel(box.right, box.bottom);
  const Range x = range(low.x(), high.x(), grid.width), y = range(low.y(), high.y(), grid.height);
  Windows windows;
  for (int l = finest; l < static_cast<int>(levels.size()); ++l) {
    const RasterLevel<uint32_t>& level = levels[static_cast<size_t>(l)];
    add(windows, l, {std::max((x.first >> l) - kMargin, 0), std::min((x.last >> l) + kMargin, level.width - 1)},
        {std::max((y.first >> l) - kMargin, 0), std::min((y.last >> l) + kMargin, level.height - 1)});
  }
  return windows;
}

template <typename T>
void copy_windows(const Windows& windows, const std::vector<RasterLevel<T>>& levels, const std::vector<T>& level_0, T* out) {
  for (size_t l = 0; l < levels.size(); ++l) {
    const shaders::RenderWindow& w = windows.levels[l];
    const T* data = l == 0 ? level_0.data() : levels[l].data.data();
    for (int v = 0; v < w.height; ++v)
      std::copy_n(data + static_cast<size_t>(w.y + v) * static_cast<size_t>(levels[l].width) + w.x, w.width,
                  out + w.offset + static_cast<size_t>(v) * static_cast<size_t>(w.width));
  }
}

template Windows whole(const std::vector<RasterLevel<float>>&);
template Windows whole(const std::vector<RasterLevel<uint32_t>>&);
template void copy_windows(const Windows&, const std::vector<RasterLevel<float>>&, const std::vector<float>&, float*);
template void copy_windows(const Windows&, const std::vector<RasterLevel<uint32_t>>&, const std::vector<uint32_t>&, uint32_t*);

}  // namespace iclk
