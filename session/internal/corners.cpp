#include <iclk/session/internal/corners.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace iclk {
namespace {

constexpr int kReach = 3, kRing = 8;  // half width of a box; number of kept rows, a power of two above 2 kReach
constexpr auto kWeight = static_cast<float>(1.0 / (4 * 7 * 255));

/// Mirrors an index at the border, which is not repeated.
int mirrored(int i, int n) {
  if (n == 1) return 0;
  while (i < 0 || i >= n) i = i < 0 ? -i : 2 * (n - 1) - i;
  return i;
}

/// a * b + c, rounded once like an FMA instruction, which not every processor has. In double precision, integers below 2^12
/// times a float are exact, and so is the sum with a value of similar size.
float fused(int a, float b, float c) { return static_cast<float>(static_cast<double>(a) * b + c); }

using Sums = std::array<std::vector<double>, 3>;  // of a row: of gu gu, gu gv and gv gv

/// Computes the gradients of successive rows, and the sums of their products over 2 kReach + 1 columns.
class Rows {
 public:
  Rows(const std::vector<uint8_t>& grey, int width, int height)
      : grey_(grey), width_(width), height_(height), pixels_(size() + 2) {
    for (size_t i = 0; i < 3; ++i) steps_[i].resize(size()), means_[i].resize(size());
    for (auto& p : products_) p.resize(size() + 2 * kReach);
    for (int v = -1; v < 1; ++v) prepare(v);
  }

  /// The sums of row v. Precondition: called for rows 0, 1, 2, ... in order.
  void sums(int v, Sums& out) {
    prepare(v + 1);
    multiply(v);
    for (size_t i = 0; i < 3; ++i) out[i].resize(size());
    const float *xx = products_[0].data(), *xy = products_[1].data(), *yy = products_[2].data();
    double a = 0, b = 0, c = 0;
    for (int i = 0; i < 2 * kReach + 1; ++i) a += xx[i], b += xy[i], c += yy[i];
    double *first = out[0].data(), *second = out[1].data(), *third = out[2].data();
    first[0] = a, second[0] = b, third[0] = c;
    for (int u = 1; u < width_; ++u) {
      a += static_cast<double>(xx[u + 2 * kReach]) - xx[u - 1];
      b += static_cast<double>(xy[u + 2 * kReach]) - xy[u - 1];
      c += static_cast<double>(yy[u + 2 * kReach]) - yy[u - 1];
      first[u] = a, second[u] = b, third[u] = c;
    }
  }

 private:
  size_t size() const { return static_cast<size_t>(width_); }
  static size_t slot(int v) { return static_cast<size_t>(v + 3) % 3; }

  /// Computes the differences along a row of pixels, and their weighted means.
  void prepare(int v) {
    const uint8_t* row = grey_.data() + size() * static_cast<size_t>(mirrored(v, height_));
    for (size_t i = 0; i < size(); ++i) pixels_[i + 1] = row[i];
    pixels_.front() = row[mirrored(-1, width_)];
    pixels_.back() = row[mirrored(width_, width_)];
    const int* p = pixels_.data();
    int* step = steps_[slot(v)].data();
    float* mean = means_[slot(v)].data();
    for (int u = 0; u < width_; ++u) {
      step[u] = p[u + 2] - p[u];
      mean[u] = fused(p[u + 2], kWeight, fused(p[u + 1], 2 * kWeight, static_cast<float>(p[u]) * kWeight));
    }
  }

  void multiply(int v) {
    const int *above = steps_[slot(v - 1)].data(), *here = steps_[slot(v)].data(), *below = steps_[slot(v + 1)].data();
    const float *mean_above = means_[slot(v - 1)].data(), *mean_below = means_[slot(v + 1)].data();
    float *xx = products_[0].data() + kReach, *xy = products_[1].data() + kReach, *yy = products_[2].data() + kReach;
    for (int u = 0; u < width_; ++u) {
      const float gu = fused(above[u] + below[u], kWeight, static_cast<float>(here[u]) * (2 * kWeight));
      const float gv = mean_below[u] - mean_above[u];
      xx[u] = gu * gu, xy[u] = gu * gv, yy[u] = gv * gv;
    }
    for (auto& p : products_)
      for (int i = 1; i <= kReach; ++i) {
        p[static_cast<size_t>(kReach - i)] = p[static_cast<size_t>(kReach + mirrored(-i, width_))];
        p[static_cast<size_t>(kReach + width_ - 1 + i)] = p[static_cast<size_t>(kReach + mirrored(width_ - 1 + i, width_))];
      }
  }

  const std::vector<uint8_t>& grey_;
  const int width_, height_;
  std::vector<int> pixels_;
  std::array<std::vector<int>, 3> steps_;  // of the rows above, here and below
  std::array<std::vector<float>, 3> means_;
  std::array<std::vector<float>, 3> products_;
};

}  // namespace

std::vector<float> corner_response(const std::vector<uint8_t>& grey, int width, int height) {
  const auto columns = static_cast<size_t>(width);
  Rows rows(grey, width, height);
  std::array<Sums, kRing> ring;
  const auto at = [&](int v) -> Sums& { return ring[static_cast<size_t>(mirrored(v, height)) % kRing]; };
  int next = 0;
  for (; next < std::min(kReach, height); ++next) rows.sums(next, at(next));
  Sums box;
  for (auto& sums : box) sums.assign(columns, 0);
  const auto enter = [&](int v) {
    for (size_t i = 0; i < 3; ++i)
      for (size_t u = 0; u < columns; ++u) box[i][u] += at(v)[i][u];
  };
  std::vector<float> out(columns * static_cast<size_t>(height));
  for (int v = 0; v < height; ++v) {
    if (next < height) rows.sums(next, at(next)), ++next;
    if (v == 0)
      for (int i = -kReach; i < kReach; ++i) enter(i);
    const Sums &entering = at(v + kReach), &leaving = at(v - kReach);
    const auto slide = [&](size_t i, size_t u) {
      const double sum = box[i][u] + entering[i][u];
      box[i][u] = sum - leaving[i][u];
      return static_cast<float>(sum);
    };
    float* response = out.data() + columns * static_cast<size_t>(v);
    for (size_t u = 0; u < columns; ++u) {
      const float a = 0.5f * slide(0, u), b = slide(1, u), c = 0.5f * slide(2, u);
      response[u] = (a + c) - std::sqrt((a - c) * (a - c) + b * b);
    }
  }
  return out;
}

}  // namespace iclk
