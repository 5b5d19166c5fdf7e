#include <iclk/align/search/lines.h>

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include <Eigen/Geometry>
#include <unsupported/Eigen/FFT>

#include <iclk/align/common/each.h>

namespace iclk::internal {
namespace {

using Eigen::Index;
using Eigen::Vector2d;

constexpr double kRollStep = 5 * M_PI / 180;
constexpr int kUpright = 6;                                  // steps to either side
constexpr double kScales[] = {0.84, 0.92, 1.0, 1.09, 1.19};  // that the steps of the roll would also tell apart
constexpr Index kAround = 6;                                 // pixels to either side: lines are compared with those around them
constexpr float kLeast = 0.01f;                              // of the lines' strength
constexpr double kOverlap = 0.3;                             // of the map
constexpr double kClear = 1.15, kClearOfAll = 1.1;           // times the score of any other place: upright, at all rolls
constexpr double kAnotherPlace = 5;                          // pixels of the map

/// Means over the squares around each place, which end at the border.
template <class Values>
Values means(const Values& map, Index around) {
  Values rows(map.rows(), map.cols()), all(map.rows(), map.cols());
  const auto window = [around](Index at, Index size) {
    const Index first = std::max<Index>(0, at - around);
    return std::pair(first, std::min(size, at + around + 1) - first);
  };
  for (Index v = 0; v < map.rows(); ++v) {
    const auto [first, count] = window(v, map.rows());
    rows.row(v) = map.middleRows(first, count).colwise().mean();
  }
  for (Index u = 0; u < map.cols(); ++u) {
    const auto [first, count] = window(u, map.cols());
    all.col(u) = rows.middleCols(first, count).rowwise().mean();
  }
  return all;
}

/// The next size that a Fourier transform is fast for.
Index fast_size(Index least) {
  for (Index n = least;; ++n) {
    Index rest = n;
    for (const Index factor : {2, 3, 5})
      while (rest % factor == 0) rest /= factor;
    if (rest == 1) return n;
  }
}

/// Fourier transforms of maps that are padded with zeros, transposed.
class Transform {
 public:
  Transform(Index rows, Index cols) : rows_(rows), cols_(cols) {}
  Lines forward(const Lines& map) {
    Lines padded = Lines::Zero(rows_, cols_);
    padded.topLeftCorner(map.rows(), map.cols()) = map;
    return each_column(each_column(padded, &Fft::fwd).transpose(), &Fft::fwd);
  }
  Lines backward(const Lines& spectrum) { return each_column(each_column(spectrum, &Fft::inv).transpose(), &Fft::inv); }

 private:
  using Fft = Eigen::FFT<float>;
  using Direction = void (Fft::*)(std::complex<float>*, const std::complex<float>*, Index);
  Lines each_column(const Lines& map, Direction direction) {
    Lines out(map.rows(), map.cols());
    for (Index c = 0; c < map.cols(); ++c) (fft_.*direction)(out.col(c).data(), map.col(c).data(), map.rows());
    return out;
  }

  Fft fft_;
  Index rows_, cols_;
};

/// The map as the similarity without a shift shows it.
Lines turned(const Lines& lines, const Similarity& s) {
  Lines out = Lines::Zero(lines.rows(), lines.cols());
  const Eigen::Matrix2d back = Eigen::Rotation2Dd(-s.roll).toRotationMatrix() / s.scale;
  const std::complex<float> turn = std::polar(1.0f, static_cast<float>(2 * s.roll));
  for (Index u = 0; u < out.cols(); ++u)
    for (Index v = 0; v < out.rows(); ++v) {
      out(v, u) = turn * sample(lines, s.centre + back * (Vector2d(u, v) - s.centre));
    }
  return out;
}

struct Match {
  Similarity similarity;
  double score = 0, next = 0;  ///< of the best shift, and of another place
};

/// Calls `each` for every shift of a map over another, with the score of what agrees: its sum over the root of the overlap.
template <class Each>
void each_shift(const Lines& found, Index rows, Index cols, const Each& each) {
  for (Index u = 1 - cols; u < cols; ++u)
    for (Index v = 1 - rows; v < rows; ++v) {
      const auto overlap = static_cast<double>((cols - std::abs(u)) * (rows - std::abs(v)));
      if (overlap < kOverlap * static_cast<double>(rows * cols)) continue;
      const float sum = found((v + found.rows()) % found.rows(), (u + found.cols()) % found.cols()).real();
      each(Vector2d(u, v), sum / std::sqrt(overlap));
    }
}

/// The best shift of a roll and a scale.
Match best_shift(const Lines& reference, const Lines& spectrum, Similarity s, Transform& transform) {
  const Lines found = transform.backward(spectrum.cwiseProduct(transform.forward(turned(reference, s)).conjugate()));
  Match best{s};
  each_shift(found, reference.rows(), reference.cols(), [&](const Vector2d& shift, double score) {
    if (score > best.score) best.score = score, best.similarity.shift = shift;
  });
  each_shift(found, reference.rows(), reference.cols(), [&](const Vector2d& shift, double score) {
    if ((shift - best.similarity.shift).norm() > kAnotherPlace) best.next = std::max(best.next, score);
  });
  return best;
}

/// Whether two motions put the middles of opposite quarters elsewhere.
bool another_place(const Similarity& a, const Similarity& b) {
  const Vector2d corner = 0.5 * a.centre;
  return ((a(corner) - b(corner)).norm() + (a(3 * corner) - b(3 * corner)).norm()) / 2 > kAnotherPlace;
}

std::optional<Similarity> clearly_best(const std::vector<Match>& matches, double clear) {
  const auto less = [](const Match& a, const Match& b) { return a.score < b.score; };
  const Match& best = *std::max_element(matches.begin(), matches.end(), less);
  if (clear * best.next > best.score) return {};
  for (const Match& other : matches)
    if (clear * other.score > best.score && another_place(other.similarity, best.similarity)) return {};
  return best.score > 0 ? std::optional(best.similarity) : std::nullopt;
}

}  // namespace

Lines lines_of(const Map& grey, int scale) {
  Lines out = Lines::Zero(grey.height / scale, grey.width / scale);
  for (int v = 1; v < static_cast<int>(out.rows()) * scale && v < grey.height - 1; ++v)
    for (int u = 1; u < static_cast<int>(out.cols()) * scale && u < grey.width - 1; ++u) {
      const std::complex<float> gradient(grey.at(u + 1, v) - grey.at(u - 1, v), grey.at(u, v + 1) - grey.at(u, v - 1));
      const float length = std::sqrt(std::norm(gradient));
      if (length > 0 && length < kHiddenFrom) out(v / scale, u / scale) += gradient * gradient / (length * std::sqrt(length));
    }
  return out / static_cast<float>(scale * scale);
}

Lines distinct(const Lines& lines, Index around) {
  const Lines rest = lines - means(lines, around);
  const Eigen::MatrixXf power = means<Eigen::MatrixXf>(rest.cwiseAbs2(), around);
  const Eigen::ArrayXXf strength = rest.cwiseAbs2().array().sqrt();
  return (rest.array() * strength.max(power.array().sqrt() + kLeast).inverse()).matrix();
}

std::complex<float> sample(const Lines& lines, const Vector2d& at) {
  const auto x = static_cast<Index>(std::floor(at.x())), y = static_cast<Index>(std::floor(at.y()));
  if (x < 0 || y < 0 || x + 1 >= lines.cols() || y + 1 >= lines.rows()) return 0;
  const auto a = static_cast<float>(at.x() - static_cast<double>(x)), b = static_cast<float>(at.y() - static_cast<double>(y));
  return (1 - b) * ((1 - a) * lines(y, x) + a * lines(y, x + 1)) + b * ((1 - a) * lines(y + 1, x) + a * lines(y + 1, x + 1));
}

Vector2d Similarity::operator()(const Vector2d& place) const {
  return centre + scale * (Eigen::Rotation2Dd(roll) * (place - centre)) + shift;
}

std::optional<Similarity> match_lines(const Lines& reference, const Lines& target, int threads) {
  const Lines lines = distinct(reference, kAround);
  const Index rows = fast_size(2 * reference.rows()), cols = fast_size(2 * reference.cols());
  const Lines spectrum = Transform(rows, cols).forward(distinct(target, kAround));
  const Vector2d centre = 0.5 * Vector2d(reference.cols() - 1, reference.rows() - 1);
  const auto search = [&](int steps, double clear) {
    std::vector<Match> matches(static_cast<size_t>(2 * steps + 1) * std::size(kScales));
    for_each_of(static_cast<size_t>(2 * steps + 1), threads, [&](size_t k) {
      Transform transform(rows, cols);
      for (size_t i = 0; i < std::size(kScales); ++i) {
        const double roll = (static_cast<int>(k) - steps) * kRollStep;
        matches[k * std::size(kScales) + i] = best_shift(lines, spectrum, {roll, kScales[i], centre, {0, 0}}, transform);
      }
    });
    return clearly_best(matches, clear);
  };
  const std::optional<Similarity> upright = search(kUpright, kClear);
  return upright ? upright : search(static_cast<int>(std::lround(M_PI / kRollStep)), kClearOfAll);
}

}  // namespace iclk::internal
