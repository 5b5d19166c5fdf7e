#include <iclk/align/network/packed_weights.h>

#include <algorithm>
#include <array>

#include <iclk/shaders/network/network.h>

namespace iclk::internal {
namespace {

constexpr uint32_t kBlock = ICLK_CONV_CHANNELS;

uint32_t blocks(const ConvLayer& layer) { return (static_cast<uint32_t>(layer.out) + kBlock - 1) / kBlock; }
// The number of input planes with weights: Winograd's products process two at a time (shaders/convolution/winograd_sums.glsl).
uint32_t weight_planes(const ConvLayer& layer, ConvVariant variant) {
  const uint32_t planes = (static_cast<uint32_t>(layer.in) + 3) / 4;
  return of_whole_tiles(variant) ? (planes + 1) / 2 * 2 : planes;
}

// G of Lavin and Gray, "Fast algorithms for convolutional neural networks": 1, x, x^2 of each point over its differences to the
// other points, so that the shaders' B^T has no divisions.
using Matrix = std::vector<std::array<double, 3>>;
Matrix kernel_transform() {
  // The points at which Winograd's polynomials are multiplied, apart from infinity.
  constexpr double points[] = {0, ICLK_WINOGRAD_A, -ICLK_WINOGRAD_A, ICLK_WINOGRAD_B, -ICLK_WINOGRAD_B};
  Matrix G;
  for (double x : points) {
    double f = 1;
    for (double y : points)
      if (y != x) f *= x - y;
    G.push_back({1 / f, x / f, x * x / f});
  }
  G.push_back({0, 0, 1});  // infinity
  return G;
}

// The positions() weights of one pair of channels: the kernel by columns (direct), its columns times G (`winograd4x1`), or G g
// G^T.
std::array<float, 36> transformed(const float* g, ConvVariant variant, const Matrix& G) {
  std::array<float, 36> out{};
  const size_t m = G.size();
  if (variant == ConvVariant::direct) {
    for (size_t ky = 0; ky < 3; ++ky)
      for (size_t kx = 0; kx < 3; ++kx) out[3 * kx + ky] = g[3 * ky + kx];
    return out;
  }
  if (variant == ConvVariant::winograd4x1) {
    for (size_t kx = 0; kx < 3; ++kx)
      for (size_t i = 0; i < m; ++i) {
        double sum = 0;
        for (size_t ky = 0; ky < 3; ++ky) sum += G[i][ky] * static_cast<double>(g[3 * ky + kx]);
        out[m * kx + i] = static_cast<float>(sum);
      }
    return out;
  }
  for (size_t i = 0; i < m; ++i)
    for (size_t j = 0; j < m; ++j) {
      double sum = 0;
      for (size_t y = 0; y < 3; ++y)
        for (size_t x = 0; x < 3; ++x) sum += G[i][y] * G[j][x] * static_cast<double>(g[3 * y + x]);
      out[m * i + j] = static_cast<float>(sum);
    }
  return out;
}

}  // namespace

bool of_whole_tiles(ConvVariant variant) { return variant == ConvVariant::winograd4; }
uint32_t positions(ConvVariant variant) {
  if (variant == ConvVariant::direct) return 9;
  if (variant == ConvVariant::winograd4x1) return 18;
  return 36;
}

uint64_t packed_texels(const ConvLayer& layer, ConvVariant variant) {
  return static_cast<uint64_t>(blocks(layer)) *
         (static_cast<uint64_t>(positions(variant)) * weight_planes(layer, variant) * kBlock + 2);
}

PackedLayer PackedWeights::add(const ConvLayer& layer, ConvVariant variant) {
  const size_t in = static_cast<size_t>(layer.in), out = static_cast<size_t>(layer.out), n = positions(variant),
               in_planes = weight_planes(layer, variant);
  const size_t first = data_.size();
  data_.resize(first + 4 * packed_texels(layer, variant), 0.0f);
  float* to = data_.data() + first;
  const Matrix G = kernel_transform();
  for (size_t o = 0; o < out; ++o)
    for (size_t i = 0; i < in; ++i) {
      const auto values = transformed(&layer.weight[(o * in + i) * 9], variant, G);
      const size_t half = o % kBlock / 4;
      for (size_t p = 0; p < n; ++p) {
        // Products of tiles loop over the planes at each position; the others loop over the positions of each plane.
        const size_t step = of_whole_tiles(variant) ? p * in_planes + i / 4 : (i / 4) * n + p;
        const size_t texel = (o / kBlock * n * in_planes + step) * kBlock + 2 * (i % 4) + half;
        to[4 * texel + o % 4] = values[p];
      }
    }
  PackedLayer packed;
  packed.weights = static_cast<uint32_t>(first / 4);
  packed.bias = packed.weights + static_cast<uint32_t>(blocks(layer) * n * in_planes * kBlock);
  std::copy(layer.bias.begin(), layer.bias.end(), data_.begin() + static_cast<std::ptrdiff_t>(4ull * packed.bias));
  return packed;
}

}  // namespace iclk::internal
