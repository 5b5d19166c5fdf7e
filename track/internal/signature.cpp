#include <iclk/track/internal/signature.h>

#include <algorithm>
#include <cmath>

namespace iclk::internal {
namespace {

constexpr size_t kFeatures = 100;  ///< at most
constexpr int kWidth = 160;        ///< px, at least, of the map in which patches are described
constexpr float kAlike = 0.85F;    ///< of two descriptors: their scalar product

/// The best match of each row's descriptor.
std::vector<size_t> best_of(const Eigen::MatrixXf& products) {
  std::vector<size_t> best;
  for (Eigen::Index i = 0; i < products.rows(); ++i) {
    Eigen::Index at = 0;
    products.row(i).maxCoeff(&at);
    best.push_back(static_cast<size_t>(at));
  }
  return best;
}

Eigen::MatrixXf matrix_of(const Signature& s) {
  Eigen::MatrixXf out(static_cast<Eigen::Index>(s.size()), static_cast<Eigen::Index>(MatchDescriptor().size()));
  for (size_t i = 0; i < s.size(); ++i)
    out.row(static_cast<Eigen::Index>(i)) = Eigen::Map<const Eigen::RowVectorXf>(s[i].data(), out.cols());
  return out;
}

}  // namespace

Signature signature_of(const Map& grey, std::span<const Eigen::Vector2d> uv) {
  Map small = grey;
  double scale = 1;
  for (; small.width >= 2 * kWidth; scale *= 2) small = half_size(small);
  Signature out;
  const size_t step = std::max<size_t>(1, uv.size() / kFeatures);
  for (size_t i = 0; i < uv.size() && out.size() < kFeatures; i += step) {
    const int u = static_cast<int>(std::lround((uv[i].x() + 0.5) / scale - 0.5)) - ICLK_PATCH_BEFORE;
    const int v = static_cast<int>(std::lround((uv[i].y() + 0.5) / scale - 0.5)) - ICLK_PATCH_BEFORE;
    if (u < 0 || v < 0 || u + ICLK_PATCH > small.width || v + ICLK_PATCH > small.height) continue;
    std::array<float, ICLK_PATCH_AREA> patch;
    for (int k = 0; k < ICLK_PATCH_AREA; ++k)
      patch[static_cast<size_t>(k)] = static_cast<float>(small.at(u + k % ICLK_PATCH, v + k / ICLK_PATCH));
    out.push_back(describe(patch));
  }
  return out;
}

double likeness(const Signature& a, const Signature& b) {
  if (a.empty() || b.empty()) return 0;
  const Eigen::MatrixXf products = matrix_of(a) * matrix_of(b).transpose();
  const std::vector<size_t> there = best_of(products), back = best_of(products.transpose());
  int count = 0;
  for (size_t i = 0; i < there.size(); ++i)
    count += back[there[i]] == i && products(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(there[i])) > kAlike;
  return count / static_cast<double>(a.size());
}

}  // namespace iclk::internal
