#include <iclk/align/network/network.h>

#include <algorithm>
#include <cmath>

#include <Eigen/Core>

#include <iclk/shaders/network/network.h>

namespace iclk::internal {
namespace {

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// The pixels under one tap of the kernel, for rows [v0, v0 + rows): shifted by (du, dv), zeros beyond the border.
void gather_tap(const Planes& in, int channel, int du, int dv, int v0, int rows, float* out) {
  const int first = std::clamp(-du, 0, in.width), last = std::clamp(in.width - du, first, in.width);
  for (int v = v0; v < v0 + rows; ++v, out += in.width) {
    if (v + dv < 0 || v + dv >= in.height) {
      std::fill_n(out, in.width, 0.0f);
      continue;
    }
    const float* row = in.row(channel, v + dv);
    std::fill_n(out, first, 0.0f);
    std::copy(row + (first + du), row + (last + du), out + first);
    std::fill(out + last, out + in.width, 0.0f);
  }
}

/// Normalises all values together to zero mean and unit deviation. Pixels with a NaN channel are left out.
void normalise(std::vector<Map>& maps) {
  const size_t pixels = maps.front().data.size();
  std::vector<bool> counts(pixels);
  double sum = 0, squares = 0, count = 0;
  for (size_t i = 0; i < pixels; ++i) {
    counts[i] = std::all_of(maps.begin(), maps.end(), [&](const Map& m) { return std::abs(m.data[i]) < ICLK_LARGEST_PIXEL; });
    if (!counts[i]) continue;
    for (const Map& map : maps) sum += map.data[i];
    count += static_cast<double>(maps.size());
  }
  const double mean = sum / std::max(count, 1.0);
  for (const Map& map : maps)
    for (size_t i = 0; i < pixels; ++i)
      if (counts[i]) squares += (map.data[i] - mean) * (map.data[i] - mean);
  const double inverse = 1 / std::max(std::sqrt(squares / std::max(count, 1.0)), ICLK_LEAST_DEVIATION);
  for (Map& map : maps)
    for (float& x : map.data) x = static_cast<float>((x - mean) * inverse);
}

}  // namespace

Planes network_input(const Model& model, const ImageView& image) {
  std::vector<Map> maps;
  if (model.input_channels == 1)
    maps.push_back(grey_map(image));
  else
    maps = rgb_maps(image);
  if (model.normalisation == Normalisation::image) normalise(maps);
  Planes out(model.input_channels, image.width, image.height);
  for (size_t c = 0; c < maps.size(); ++c) {
    const float mean = model.mean[c], inverse = 1 / model.std[c];
    std::transform(maps[c].data.begin(), maps[c].data.end(), out.row(static_cast<int>(c), 0),
                   [&](float x) { return (x - mean) * inverse; });
  }
  return out;
}

Planes convolve(const Planes& in, const ConvLayer& layer) {
  // One matrix product per group of rows: weights (out x 9 in) by the pixels under each tap (9 in x pixels). The group is small
  // enough that the pixels stay in the cache.
  constexpr int kCacheFloats = 1 << 17;
  const int taps = 9 * layer.in;
  const int strip = std::clamp(kCacheFloats / (taps * in.width), 1, in.height);
  const Eigen::Map<const Matrix> weight(layer.weight.data(), layer.out, taps);
  const Eigen::Map<const Eigen::VectorXf> bias(layer.bias.data(), layer.out);
  Planes out(layer.out, in.width, in.height);
  Eigen::Map<Matrix> result(out.data.data(), layer.out, static_cast<Eigen::Index>(out.plane()));
  Matrix pixels;
  for (int v0 = 0; v0 < in.height; v0 += strip) {
    const int rows = std::min(strip, in.height - v0), n = rows * in.width;
    pixels.resize(taps, n);
    for (int tap = 0; tap < taps; ++tap)
      gather_tap(in, tap / 9, (tap % 3 - 1) * layer.dilation, (tap % 9 / 3 - 1) * layer.dilation, v0, rows,
                 pixels.row(tap).data());
    auto part = result.middleCols(static_cast<Eigen::Index>(v0) * in.width, n);
    part.noalias() = weight * pixels;
    part.colwise() += bias;
    for (int c = 0; c < layer.out; ++c)
      for (float* x = part.row(c).data(); x != part.row(c).data() + n; ++x)
        if (*x < 0) *x = std::expm1(*x);
  }
  return out;
}

Planes half_size(const Planes& in) {
  Planes out(in.channels, in.width / 2, in.height / 2);
  for (int c = 0; c < out.channels; ++c)
    for (int v = 0; v < out.height; ++v) {
      const float *a = in.row(c, 2 * v), *b = in.row(c, 2 * v + 1);
      float* mean = out.row(c, v);
      for (int u = 0; u < out.width; ++u) mean[u] = 0.25f * ((a[2 * u] + a[2 * u + 1]) + (b[2 * u] + b[2 * u + 1]));
    }
  return out;
}

Pyramid encode(const Model& model, const ImageView& image, int levels) {
  Pyramid pyramid;
  Planes x = network_input(model, image);
  for (int level = 0; level < levels; ++level) {
    if (level > 0) x = half_size(x);
    for (const ConvLayer& layer : model.encoder[static_cast<size_t>(level)]) x = convolve(x, layer);
    Map mean(x.width, x.height);
    Eigen::Map<Eigen::RowVectorXf>(mean.data.data(), static_cast<Eigen::Index>(x.plane())) =
        Eigen::Map<const Matrix>(x.data.data(), x.channels, static_cast<Eigen::Index>(x.plane())).colwise().mean();
    pyramid.push_back(std::move(mean));
  }
  return pyramid;
}

}  // namespace iclk::internal
