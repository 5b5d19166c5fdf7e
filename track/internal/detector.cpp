#include <iclk/track/internal/detector.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include <iclk/shaders/shared.h>

namespace iclk::internal {
namespace {

constexpr double kLeastTexture = 1e-5;  // smaller eigenvalue of the mean gradient matrix, (grey / px)^2
/// The largest relative spread of a patch's depths. More is a depth edge, which is used last.
constexpr double kSpread = 0.05;

/// The smaller eigenvalue of the mean gradient matrix over 7x7 pixels, at every pixel.
Map texture_of(const Map& grey) {
  constexpr int kReach = 3;
  const int w = grey.width, h = grey.height;
  Map xx(w, h), xy(w, h), yy(w, h), out(w, h);
  for (int v = 0; v < h; ++v)
    for (int u = 0; u < w; ++u) {
      const auto gu = static_cast<float>(grey.gradient_u(u, v)), gv = static_cast<float>(grey.gradient_v(u, v));
      xx.at(u, v) = gu * gu;
      xy.at(u, v) = gu * gv;
      yy.at(u, v) = gv * gv;
    }
  // A box filter: running sums of rows, then of columns.
  const auto box = [&](Map& m) {
    std::vector<float> line(static_cast<size_t>(std::max(w, h)));
    const auto slide = [&](int n, auto at) {
      float sum = 0;
      for (int i = 0; i < n; ++i) line[static_cast<size_t>(i)] = at(i);
      for (int i = 0; i < std::min(kReach, n); ++i) sum += line[static_cast<size_t>(i)];
      for (int i = 0; i < n; ++i) {
        if (i + kReach < n) sum += line[static_cast<size_t>(i + kReach)];
        if (i - kReach - 1 >= 0) sum -= line[static_cast<size_t>(i - kReach - 1)];
        at(i) = sum;
      }
    };
    for (int v = 0; v < h; ++v) slide(w, [&](int i) -> float& { return m.at(i, v); });
    for (int u = 0; u < w; ++u) slide(h, [&](int i) -> float& { return m.at(u, i); });
  };
  for (Map* m : {&xx, &xy, &yy}) box(*m);
  constexpr float kArea = (2 * kReach + 1) * (2 * kReach + 1);
  for (size_t i = 0; i < out.data.size(); ++i) {
    const float half_trace = 0.5f * (xx.data[i] + yy.data[i]), half_difference = 0.5f * (xx.data[i] - yy.data[i]);
    const float root = std::sqrt(half_difference * half_difference + xy.data[i] * xy.data[i]);
    out.data[i] = std::isfinite(half_trace) ? (half_trace - root) / kArea : 0;
  }
  return out;
}

/// Whether the patch around a pixel has depth everywhere, without an edge.
bool smooth(const ImageView& depth, int u, int v) {
  double low = INFINITY, high = 0;
  for (int y = v - ICLK_PATCH_BEFORE; y < v - ICLK_PATCH_BEFORE + ICLK_PATCH; ++y)
    for (int x = u - ICLK_PATCH_BEFORE; x < u - ICLK_PATCH_BEFORE + ICLK_PATCH; ++x) {
      const double z = depth_at(depth, x, y);
      low = std::min(low, z);
      high = std::max(high, z);
    }
  return low > 0 && high - low <= kSpread * depth_at(depth, u, v);
}

struct Corner {
  float texture;
  int u, v;
  bool edge;  ///< of depth
};

/// Whether a pixel is the maximum of its 3x3 neighbourhood, as a corner must be.
bool peak(const Map& texture, int u, int v) {
  const float t = texture.at(u, v);
  for (int y = v - 1; y <= v + 1; ++y)
    for (int x = u - 1; x <= u + 1; ++x)
      if (texture.at(x, y) > t) return false;
  return true;
}

/// Chooses the corners with the most texture in each cell of a lattice, round by round. Those that `admit` marks as edges come
/// last. Places near `taken` stay free.
template <class Admit>
std::vector<Eigen::Vector2d> pick(const Map& grey, int count, int wanted_border, std::vector<Eigen::Vector2d> taken,
                                  const Admit& admit) {
  const int w = grey.width, h = grey.height;
  const int border = std::max(ICLK_PATCH, std::min(wanted_border, std::min(w, h) / 4));
  if (w <= 2 * border || h <= 2 * border || count < 1) return {};
  const Map texture = texture_of(grey);
  const double inner_w = w - 2 * border, inner_h = h - 2 * border;
  const int columns = std::max(1, static_cast<int>(std::lround(std::sqrt(count * inner_w / inner_h))));
  const int rows = std::max(1, count / columns);
  std::vector<std::vector<Corner>> cells(static_cast<size_t>(columns) * static_cast<size_t>(rows));
  for (int v = border; v < h - border; ++v)
    for (int u = border; u < w - border; ++u) {
      if (!(texture.at(u, v) > kLeastTexture)) continue;
      const std::optional<bool> edge = admit(u, v);
      if (!edge || !peak(texture, u, v)) continue;
      const auto column = static_cast<size_t>((u - border) * columns / (w - 2 * border));
      const auto row = static_cast<size_t>((v - border) * rows / (h - 2 * border));
      cells[row * static_cast<size_t>(columns) + column].push_back({texture.at(u, v), u, v, *edge});
    }
  for (auto& cell : cells)
    std::stable_sort(cell.begin(), cell.end(),
                     [](const Corner& a, const Corner& b) { return a.edge != b.edge ? b.edge : a.texture > b.texture; });
  const auto is_free = [&](const Corner& c) {
    return std::none_of(taken.begin(), taken.end(), [&](const Eigen::Vector2d& p) {
      return std::max(std::abs(p.x() - c.u), std::abs(p.y() - c.v)) < kCornerDistance;
    });
  };
  const size_t before = taken.size(), most = before + static_cast<size_t>(count);
  // One corner per cell and round; depth edges come after all other corners of all cells.
  for (const bool edges : {false, true})
    for (bool found = true; found && taken.size() < most;) {
      found = false;
      for (auto& cell : cells) {
        if (taken.size() == most) break;
        const auto next =
            std::find_if(cell.begin(), cell.end(), [&](const Corner& c) { return c.edge == edges && is_free(c); });
        if (next == cell.end()) continue;
        found = true;
        taken.emplace_back(next->u, next->v);
        cell.erase(next);
      }
    }
  return {taken.begin() + static_cast<std::ptrdiff_t>(before), taken.end()};
}

/// Whether no pixel of the patch is masked.
bool seen(const ImageView& mask, int u, int v) {
  if (mask.empty()) return true;
  for (int y = v - ICLK_PATCH_BEFORE; y < v - ICLK_PATCH_BEFORE + ICLK_PATCH; ++y)
    for (int x = u - ICLK_PATCH_BEFORE; x < u - ICLK_PATCH_BEFORE + ICLK_PATCH; ++x)
      if (mask.row(y)[x] == 0) return false;
  return true;
}

}  // namespace

double depth_at(const ImageView& depth, int u, int v) {
  const float z = reinterpret_cast<const float*>(depth.row(v))[u];
  return std::isfinite(z) && z > 0 ? z : 0;
}

Features detect_corners(const Map& grey, const ImageView& depth, const ImageView& mask, int count, int border) {
  Features out;
  out.uv = pick(grey, count, border, {}, [&](int u, int v) -> std::optional<bool> {
    if (depth_at(depth, u, v) == 0 || !seen(mask, u, v)) return {};
    return !smooth(depth, u, v);
  });
  for (const Eigen::Vector2d& uv : out.uv)
    out.inverse_depth.push_back(1 / depth_at(depth, static_cast<int>(uv.x()), static_cast<int>(uv.y())));
  return out;
}

std::vector<Eigen::Vector2d> detect_seeds(const Map& grey, const ImageView& depth, const ImageView& mask,
                                          const std::vector<Eigen::Vector2d>& taken, int count, int border) {
  return pick(grey, count, border, taken, [&](int u, int v) -> std::optional<bool> {
    if ((!depth.empty() && depth_at(depth, u, v) > 0) || !seen(mask, u, v)) return {};
    return false;
  });
}

}  // namespace iclk::internal
