#include <iclk/session/detect.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>

#include <iclk/engine/error.h>
#include <iclk/refine/feature_alignment.h>
#include <iclk/session/internal/corners.h>
#include <iclk/session/internal/grey.h>
#include <iclk/session/io/text.h>
#include <iclk/shaders/shared.h>

namespace iclk {
namespace {

constexpr float kMaxDepthSpread =
    0.05f;                       // of the patch's depth; a floor seen at 70 degrees spreads by 4 % over 8 px at f = 500
constexpr float kResponse = 4;   // corner_response() of a texture of 1
constexpr int kMinDistance = 8;  // px: a patch; less in images of fewer than 64 px

struct Pixel {
  int u, v;
};

struct Box {
  int u, v, width, height;
};

/// One value per pixel, row by row.
template <class T>
struct Grid {
  int width = 0, height = 0;
  std::vector<T> data;

  Grid(int w, int h, std::vector<T> values) : width(w), height(h), data(std::move(values)) {}
  Grid(int w, int h) : Grid(w, h, std::vector<T>(static_cast<size_t>(w) * static_cast<size_t>(h))) {}
  T* row(int v) { return data.data() + static_cast<size_t>(v) * static_cast<size_t>(width); }
  const T* row(int v) const { return data.data() + static_cast<size_t>(v) * static_cast<size_t>(width); }
};

/// The least or greatest value in the part of each pixel's patch that lies in the image. It works row by row, so that the rows
/// stay in the cache. `load(v, to)` loads row v.
template <class T, class Of, class Load>
class PatchRows {
 public:
  PatchRows(int width, int height, Of of, Load load) : width_(width), height_(height), of_(of), load_(load), out_(size()) {
    for (auto& row : along_) row.resize(size() + kMore);
  }

  const T* next() {
    for (; loaded_ <= std::min(v_ + kMore - ICLK_PATCH_BEFORE, height_ - 1); ++loaded_) load_along(loaded_);
    const int first = std::max(v_ - ICLK_PATCH_BEFORE, 0);
    std::copy_n(along(first), width_, out_.data());
    for (int v = first + 1; v < loaded_; ++v) fold(out_.data(), along(v), width_);
    ++v_;
    return out_.data();
  }

 private:
  static constexpr int kMore = ICLK_PATCH - 1;
  size_t size() const { return static_cast<size_t>(width_); }
  T* along(int v) { return along_[static_cast<size_t>(v % ICLK_PATCH)].data(); }

  void fold(T* to, const T* with, int count) {
    for (int i = 0; i < count; ++i) to[i] = of_(to[i], with[i]);
  }

  void load_along(int v) {
    T* p = along(v);
    load_(v, p + ICLK_PATCH_BEFORE);
    std::fill_n(p, ICLK_PATCH_BEFORE, p[ICLK_PATCH_BEFORE]);
    std::fill_n(p + ICLK_PATCH_BEFORE + width_, kMore - ICLK_PATCH_BEFORE, p[ICLK_PATCH_BEFORE + width_ - 1]);
    static_assert(ICLK_PATCH == 8, "doubled three times");
    for (int reach = 1, n = width_ + kMore; reach < ICLK_PATCH; n -= reach, reach *= 2) fold(p, p + reach, n - reach);
  }

  const int width_, height_;
  const Of of_;
  const Load load_;
  int v_ = 0, loaded_ = 0;
  std::array<std::vector<T>, ICLK_PATCH> along_;
  std::vector<T> out_;
};

/// The suitability of a pixel for features.
enum Place : uint8_t {
  nowhere,  ///< not seen, or without depth
  edge,     ///< seen, with depth
  smooth,   ///< and so is its whole patch, which has one depth
};

Grid<Place> find_places(const ImageView& depth, const ImageView& seen, int border) {
  const int w = depth.width, h = depth.height;
  const auto metres = [&](int v, float* to) {
    const float* from = reinterpret_cast<const float*>(depth.row(v));
    for (int u = 0; u < w; ++u) to[u] = from[u] > 0 && from[u] < INFINITY ? from[u] : 0;
  };
  const auto seen_row = [&](int v, uint8_t* to) { seen.empty() ? std::fill_n(to, w, 1) : std::copy_n(seen.row(v), w, to); };
  const auto least = [](auto a, auto b) { return a < b ? a : b; };
  const auto greatest = [](float a, float b) { return a > b ? a : b; };
  PatchRows<float, decltype(least), decltype(metres)> lows(w, h, least, metres);  // 0 where any pixel has no depth
  PatchRows<float, decltype(greatest), decltype(metres)> highs(w, h, greatest, metres);
  PatchRows<uint8_t, decltype(least), decltype(seen_row)> shown(w, h, least, seen_row);
  std::vector<float> row(static_cast<size_t>(w));
  Grid<Place> places(w, h);
  for (int v = 0; v < h; ++v) {
    const float *low = lows.next(), *high = highs.next();
    const uint8_t* whole = shown.next();
    if (v < border || v >= h - border) continue;
    metres(v, row.data());
    const float* here = row.data();
    Place* place = places.row(v);
    for (int u = border; u < w - border; ++u) {
      const float z = here[u];
      const int one = (low[u] > 0) & (high[u] - low[u] <= kMaxDepthSpread * z);  // no branches: depth varies
      place[u] = static_cast<Place>(((z > 0) & (whole[u] != 0)) * (edge + one));
    }
  }
  return places;
}

/// Half the width of each row of a disc, from its middle on.
std::vector<int> disc(int radius) {
  std::vector<int> half(static_cast<size_t>(radius) + 1);
  const auto reach = [&](int row) -> int& { return half[static_cast<size_t>(row)]; };
  for (int x = radius, y = 0, error = 0; x >= y; ++y) {  // Bresenham's, by octants
    reach(y) = std::max(reach(y), x);
    reach(x) = std::max(reach(x), y);
    error += 2 * y + 1;
    if (error > 0) error -= 2 * x - 1, --x;
  }
  return half;
}

Features take(const std::vector<Pixel>& pixels, const ImageView& depth) {
  Features out;
  for (const Pixel& p : pixels) {
    out.uv.emplace_back(p.u, p.v);
    out.inverse_depth.push_back(1.0 / reinterpret_cast<const float*>(depth.row(p.v))[p.u]);
  }
  return out;
}

/// Boxes of the image, `count` in all, row by row, nearly square.
std::vector<Box> cells(int image_width, int image_height, int count, int border) {
  const int width = image_width - 2 * border, height = image_height - 2 * border;
  std::vector<Box> out;
  if (width <= 0 || height <= 0) return out;
  const int rows = std::clamp(static_cast<int>(std::lround(std::sqrt(static_cast<double>(count) * height / width))), 1, count);
  const auto part = [](int whole, int i, int parts) { return static_cast<int>(static_cast<int64_t>(whole) * i / parts); };
  for (int r = 0; r < rows; ++r) {
    const int columns = part(count, r + 1, rows) - part(count, r, rows);
    const int v0 = part(height, r, rows), v1 = part(height, r + 1, rows);
    for (int c = 0; c < columns; ++c) {
      const int u0 = part(width, c, columns), u1 = part(width, c + 1, columns);
      if (u1 > u0 && v1 > v0) out.push_back({border + u0, border + v0, u1 - u0, v1 - v0});
    }
  }
  return out;
}

struct Corner {
  float strength;
  Pixel at;
};

/// The strongest pixel of a box, the first of equal ones; strength 0 if none is positive.
Corner strongest(const Grid<float>& strength, const Box& box) {
  constexpr int kLanes = 8;  // compared at a time
  Corner best{0, {}};
  for (int v = box.v; v < box.v + box.height; ++v) {
    const float* row = strength.row(v) + box.u;
    float most[kLanes] = {};
    int u = 0;
    for (; u + kLanes <= box.width; u += kLanes)
      for (int i = 0; i < kLanes; ++i) most[i] = row[u + i] > most[i] ? row[u + i] : most[i];
    for (; u < box.width; ++u) most[0] = std::max(most[0], row[u]);
    const float greatest = *std::max_element(most, most + kLanes);
    if (greatest > best.strength)
      best = {greatest, {box.u + static_cast<int>(std::find(row, row + box.width, greatest) - row), v}};
  }
  return best;
}

/// Chooses corners that are at least a few pixels apart: pixels near a chosen one have no strength.
std::vector<Pixel> pick_corners(const std::vector<uint8_t>& grey, const Grid<Place>& places, const DetectorOptions& options) {
  const int w = places.width, h = places.height;
  Grid<float> strength(w, h, corner_response(grey, w, h));
  for (size_t i = 0; i < strength.data.size(); ++i) {  // negative at depth edges until their round
    const float r = strength.data[i] > 0 ? strength.data[i] : 0;
    strength.data[i] = places.data[i] == smooth ? r : places.data[i] == edge ? -r : 0;
  }
  const std::vector<int> near = disc(std::clamp(std::min(w, h) / 8, 1, kMinDistance) - 1);
  const auto clear = [&](Pixel p) {
    const int radius = static_cast<int>(near.size()) - 1;
    for (int v = std::max(p.v - radius, 0); v <= std::min(p.v + radius, h - 1); ++v) {
      const int half = near[static_cast<size_t>(std::abs(v - p.v))];
      std::fill(strength.row(v) + std::max(p.u - half, 0), strength.row(v) + std::min(p.u + half + 1, w), 0.0f);
    }
  };
  const std::vector<Box> buckets = cells(w, h, options.count, options.border);
  std::vector<Pixel> taken;
  // One per bucket and round, so that all parts of the view have equal shares; depth edges come last. Before depth edges come
  // corners with too little texture for feature alignment.
  const struct {
    float threshold;
    bool edges;
  } tiers[] = {{kResponse * static_cast<float>(FeatureAlignmentOptions{}.min_texture), false}, {0, false}, {0, true}};
  for (const auto& [threshold, edges] : tiers) {
    if (std::ssize(taken) == options.count) break;
    if (edges)
      for (float& x : strength.data) x = std::abs(x);
    std::vector<Box> live = buckets;
    for (bool found = true; found && std::ssize(taken) < options.count;) {
      std::vector<Corner> round;
      std::vector<Box> still;  // buckets that still have corners
      for (const Box& bucket : live) {
        const Corner corner = strongest(strength, bucket);
        if (!(corner.strength > threshold)) continue;
        round.push_back(corner);
        still.push_back(bucket);
      }
      live = std::move(still);
      std::stable_sort(round.begin(), round.end(), [](const Corner& a, const Corner& b) { return a.strength > b.strength; });
      found = false;
      for (const Corner& corner : round) {
        if (std::ssize(taken) == options.count) break;
        if (strength.row(corner.at.v)[corner.at.u] == 0) continue;  // too close to a stronger one of this round
        taken.push_back(corner.at);
        clear(corner.at);
        found = true;
      }
    }
  }
  return taken;
}

/// Chooses the usable pixel nearest to the centre of each cell.
std::vector<Pixel> pick_grid(const Grid<Place>& places, const DetectorOptions& options) {
  std::vector<Pixel> taken;
  for (const Box& cell : cells(places.width, places.height, options.count, options.border)) {
    const Pixel centre{(2 * cell.u + cell.width) / 2, (2 * cell.v + cell.height) / 2};
    Pixel best{};
    int distance = INT32_MAX;
    for (const Place least : {smooth, edge}) {
      for (int v = cell.v; v < cell.v + cell.height; ++v)
        for (int u = cell.u; u < cell.u + cell.width; ++u) {
          const int d = (u - centre.u) * (u - centre.u) + (v - centre.v) * (v - centre.v);
          if (d < distance && places.row(v)[u] >= least) distance = d, best = {u, v};
        }
      if (distance != INT32_MAX) break;
    }
    if (distance != INT32_MAX) taken.push_back(best);
  }
  return taken;
}

std::vector<Pixel> pick_random(const Grid<Place>& places, const DetectorOptions& options) {
  std::mt19937_64 random(options.seed);
  std::vector<Pixel> taken;
  for (const Place kind : {smooth, edge}) {
    std::vector<Pixel> all;
    for (int v = 0; v < places.height; ++v)
      for (int u = 0; u < places.width; ++u)
        if (places.row(v)[u] == kind) all.push_back({u, v});
    // A partial Fisher-Yates shuffle. It uses remainders, because standard distributions differ between libraries.
    for (size_t i = 0; i < all.size() && std::ssize(taken) < options.count; ++i) {
      std::swap(all[i], all[i + random() % (all.size() - i)]);
      taken.push_back(all[i]);
    }
  }
  return taken;
}

std::string size_of(const ImageView& image) { return std::to_string(image.width) + "x" + std::to_string(image.height); }

}  // namespace

void DetectorOptions::check() const {
  const auto fail = [](const std::string& why) -> void { throw Error(ErrorCode::invalid_argument, why); };
  if (count < 1 || count > 100000) fail("feature count " + std::to_string(count) + " must lie in 1 to 100000");
  if (border < 0) fail("border " + std::to_string(border) + " must not be negative");
}

Detector parse_detector(const std::string& name) {
  if (name == "shi-tomasi") return Detector::shi_tomasi;
  if (name == "grid") return Detector::grid;
  if (name == "random") return Detector::random;
  throw Error(ErrorCode::invalid_argument,
              "detector '" + printable(name) + "' is not known; it must be shi-tomasi, grid or random");
}

Features detect_features(const ImageView& image, const ImageView& depth, const ImageView& seen, const DetectorOptions& wanted) {
  wanted.check();
  const auto same = [&](const ImageView& other) { return other.width == image.width && other.height == image.height; };
  if (image.empty() || depth.format != PixelFormat::r32f || !same(depth))
    throw Error(ErrorCode::invalid_argument, "depth of " + size_of(depth) + " for an image of " + size_of(image) +
                                                 ": depth must be r32f, of the size of the image");
  if (!seen.empty() && (seen.format != PixelFormat::r8 || !same(seen)))
    throw Error(ErrorCode::invalid_argument, "a mask of " + size_of(seen) + " for an image of " + size_of(image) +
                                                 ": the mask must be r8, of the size of the image");
  DetectorOptions options = wanted;
  options.border = std::min(options.border, std::min(image.width, image.height) / 4);
  const Grid<Place> places = find_places(depth, seen, options.border);
  std::vector<Pixel> taken;
  switch (options.detector) {
    case Detector::shi_tomasi: taken = pick_corners(grey_8bit(image), places, options); break;
    case Detector::grid: taken = pick_grid(places, options); break;
    case Detector::random: taken = pick_random(places, options); break;
  }
  if (taken.empty()) taken = pick_grid(places, options);
  return take(taken, depth);
}

}  // namespace iclk
