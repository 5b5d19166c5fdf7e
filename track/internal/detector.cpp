#include <iclk/track/internal/detector.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include <iclk/shaders/shared.h>

namespace iclk::internal {
namespace {

constexpr double kLeastTexture = 1e-5;  // eigenvalue of the mean gradient matrix, (grey / px)^2
/// The largest relative spread of a patch's depths. More is a depth edge, which is used last.
constexpr double kSpread = 0.05;

/// The eigenvalues of the mean gradient matrix over 7x7 pixels, at every pixel.
struct Texture {
  Map smaller, larger;
};

Texture texture_of(const Map& grey) {
  constexpr int kReach = 3;
  const int w = grey.width, h = grey.height;
  Map xx(w, h), xy(w, h), yy(w, h);
  Texture out{Map(w, h), Map(w, h)};
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
  for (size_t i = 0; i < xx.data.size(); ++i) {
    const float half_trace = 0.5f * (xx.data[i] + yy.data[i]), half_difference = 0.5f * (xx.data[i] - yy.data[i]);
    const float root = std::sqrt(half_difference * half_difference + xy.data[i] * xy.data[i]);
    if (!std::isfinite(half_trace)) continue;
    out.smaller.data[i] = (half_trace - root) / kArea;
    out.larger.data[i] = (half_trace + root) / kArea;
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

/// Whether the known depths of a patch differ, as at a depth edge.
bool jump(const ImageView& depth, int u, int v) {
  double low = INFINITY, high = 0;
  for (int y = v - ICLK_PATCH_BEFORE; y < v - ICLK_PATCH_BEFORE + ICLK_PATCH; ++y)
    for (int x = u - ICLK_PATCH_BEFORE; x < u - ICLK_PATCH_BEFORE + ICLK_PATCH; ++x)
      if (const double z = depth_at(depth, x, y); z > 0) {
        low = std::min(low, z);
        high = std::max(high, z);
      }
  return high - low > kSpread * depth_at(depth, u, v);
}

/// Whether a pixel is the maximum of its 3x3 neighbourhood, as a corner must be.
bool peak(const Map& texture, int u, int v) {
  const float t = texture.at(u, v);
  for (int y = v - 1; y <= v + 1; ++y)
    for (int x = u - 1; x <= u + 1; ++x)
      if (texture.at(x, y) > t) return false;
  return true;
}

/// The part of an image in which features may be.
struct Field {
  int border, width, height;
};

Field field_of(const Map& grey, int wanted_border) {
  const int border = std::max(ICLK_PATCH, std::min(wanted_border, std::min(grey.width, grey.height) / 4));
  return {border, grey.width - 2 * border, grey.height - 2 * border};
}

/// A possible feature.
struct Corner {
  Eigen::Vector2d uv;
  float texture;
  bool edge;  ///< of depth
  size_t index = 0;
};

bool before(const Corner& a, const Corner& b) { return a.edge != b.edge ? b.edge : a.texture > b.texture; }

/// Corners by the cells of a lattice.
class Lattice {
 public:
  Lattice(const Field& field, int count)
      : field_(field),
        columns_(std::max(1, static_cast<int>(std::lround(std::sqrt(1.0 * count * field.width / field.height))))),
        rows_(std::max(1, count / columns_)),
        cells_(static_cast<size_t>(columns_) * static_cast<size_t>(rows_)) {}

  void add(const Corner& corner) {
    const auto cell = [&](double at, int length, int n) {
      return std::clamp((static_cast<int>(at) - field_.border) * n / length, 0, n - 1);
    };
    const int column = cell(corner.uv.x(), field_.width, columns_), row = cell(corner.uv.y(), field_.height, rows_);
    cells_[static_cast<size_t>(row) * static_cast<size_t>(columns_) + static_cast<size_t>(column)].corners.push_back(corner);
  }

  /// Chooses `count` corners: the best of each cell, round by round. Depth edges come after all other corners of all cells.
  /// Places near `taken` stay free.
  std::vector<Corner> choose(int count, std::vector<Eigen::Vector2d> taken) {
    for (Cell& cell : cells_) std::stable_sort(cell.corners.begin(), cell.corners.end(), before);
    std::vector<Corner> chosen;
    const auto most = static_cast<size_t>(count);
    for (const bool edges : {false, true})
      for (bool found = true; found && chosen.size() < most;) {
        found = false;
        for (Cell& cell : cells_) {
          if (chosen.size() == most) break;
          const Corner* next = cell.next(edges, taken);
          if (!next) continue;
          found = true;
          taken.push_back(next->uv);
          chosen.push_back(*next);
        }
      }
    return chosen;
  }

 private:
  struct Cell {
    std::vector<Corner> corners;
    size_t at = 0;  // those before it are taken, or too near to others

    const Corner* next(bool edges, const std::vector<Eigen::Vector2d>& taken) {
      for (; at < corners.size() && (edges || !corners[at].edge); ++at) {
        const Eigen::Vector2d& uv = corners[at].uv;
        if (std::none_of(taken.begin(), taken.end(),
                         [&](const auto& p) { return (p - uv).template lpNorm<Eigen::Infinity>() < kCornerDistance; }))
          return &corners[at++];
      }
      return nullptr;
    }
  };

  Field field_;
  int columns_, rows_;
  std::vector<Cell> cells_;
};

/// Chooses `count` of the pixels that `admit` accepts. It says of each whether it is a depth edge.
template <class Admit>
std::vector<Eigen::Vector2d> pick(const Texture& texture, const Field& field, int count,
                                  const std::vector<Eigen::Vector2d>& taken, const Admit& admit) {
  if (field.width <= 0 || field.height <= 0 || count < 1) return {};
  Lattice lattice(field, count);
  for (int v = field.border; v < field.border + field.height; ++v)
    for (int u = field.border; u < field.border + field.width; ++u)
      if (const std::optional<bool> edge = admit(u, v)) lattice.add({Eigen::Vector2d(u, v), texture.smaller.at(u, v), *edge});
  std::vector<Eigen::Vector2d> out;
  for (const Corner& corner : lattice.choose(count, taken)) out.push_back(corner.uv);
  return out;
}

bool is_corner(const Texture& texture, int u, int v) {
  return texture.smaller.at(u, v) > kLeastTexture && peak(texture.smaller, u, v);
}

/// `count` of the given features, by their indices.
std::vector<size_t> best_of(const Map& grey, const Features& given, const std::vector<size_t>& usable, int count) {
  const Map texture = texture_of(grey).smaller;
  Lattice lattice({0, grey.width, grey.height}, count);
  for (const size_t i : usable) {
    const Eigen::Vector2d& uv = given.uv[i];
    const float here = texture.at(static_cast<int>(std::lround(uv.x())), static_cast<int>(std::lround(uv.y())));
    lattice.add({uv, here, false, i});
  }
  std::vector<size_t> out;
  for (const Corner& corner : lattice.choose(count, {})) out.push_back(corner.index);
  return out;
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
  const Texture texture = texture_of(grey);
  const Field field = field_of(grey, border);
  Features out;
  out.uv = pick(texture, field, count, {}, [&](int u, int v) -> std::optional<bool> {
    if (!is_corner(texture, u, v) || depth_at(depth, u, v) == 0 || !seen(mask, u, v)) return {};
    return !smooth(depth, u, v);
  });
  // Depth that is sparse rarely lies on corners. A patch beside a corner, or on an edge of the image, is worth having, too.
  const auto others = pick(texture, field, count - out.size(), out.uv, [&](int u, int v) -> std::optional<bool> {
    if (!(texture.larger.at(u, v) > kLeastTexture) || depth_at(depth, u, v) == 0 || !seen(mask, u, v)) return {};
    return jump(depth, u, v);
  });
  out.uv.insert(out.uv.end(), others.begin(), others.end());
  for (const Eigen::Vector2d& uv : out.uv)
    out.inverse_depth.push_back(1 / depth_at(depth, static_cast<int>(uv.x()), static_cast<int>(uv.y())));
  return out;
}

std::vector<Eigen::Vector2d> detect_seeds(const Map& grey, const ImageView& depth, const ImageView& mask,
                                          const std::vector<Eigen::Vector2d>& taken, int count, int border) {
  const Texture texture = texture_of(grey);
  return pick(texture, field_of(grey, border), count, taken, [&](int u, int v) -> std::optional<bool> {
    if (!is_corner(texture, u, v) || (!depth.empty() && depth_at(depth, u, v) > 0) || !seen(mask, u, v)) return {};
    return false;
  });
}

Features choose_features(const Map& grey, const Features& given, const ImageView& mask, const Camera& camera, int count) {
  const std::vector<FeatureCheck> checks = check_features(given, camera);
  std::vector<size_t> usable;
  for (size_t i = 0; i < checks.size(); ++i)
    if (const Eigen::Vector2d& uv = given.uv[i];
        checks[i] == FeatureCheck::ok && seen(mask, static_cast<int>(uv.x()), static_cast<int>(uv.y())))
      usable.push_back(i);
  if (usable.size() > static_cast<size_t>(count)) usable = best_of(grey, given, usable, count);
  Features out;
  for (const size_t i : usable) {
    out.uv.push_back(given.uv[i]);
    out.inverse_depth.push_back(given.inverse_depth[i]);
    if (!given.inverse_depth_sigma.empty()) out.inverse_depth_sigma.push_back(given.inverse_depth_sigma[i]);
  }
  return out;
}

}  // namespace iclk::internal
