#include <iclk/align/network/m_estimator.h>

#include <algorithm>
#include <cmath>

namespace iclk::internal {
namespace {

float sigmoid(float x) { return 1 / (1 + std::exp(-x)); }

/// The part [u0, u0 + width) x [v0, v0 + height).
Planes cropped(const Planes& in, int u0, int v0, int width, int height) {
  Planes out(in.channels, width, height);
  for (int c = 0; c < in.channels; ++c)
    for (int v = 0; v < height; ++v) std::copy_n(in.row(c, v0 + v) + u0, width, out.row(c, v));
  return out;
}

}  // namespace

Map m_estimator(const Model& model, const Planes& in, const Map& visible) {
  constexpr int kTile = 16;
  int reach = 0;
  for (const ConvLayer& layer : model.m_estimator) reach += layer.dilation;
  Map weight(in.width, in.height);
  for (int v0 = 0; v0 < in.height; v0 += kTile)
    for (int u0 = 0; u0 < in.width; u0 += kTile) {
      const int u1 = std::min(u0 + kTile, in.width), v1 = std::min(v0 + kTile, in.height);
      bool any = false;
      for (int v = v0; v < v1 && !any; ++v)
        for (int u = u0; u < u1 && !any; ++u) any = visible.at(u, v) > 0;
      if (!any) continue;
      // Zeros outside the image are the padding; zeros outside the halo do not affect the tile.
      const int a = std::max(u0 - reach, 0), b = std::max(v0 - reach, 0);
      Planes x = cropped(in, a, b, std::min(u1 + reach, in.width) - a, std::min(v1 + reach, in.height) - b);
      for (const ConvLayer& layer : model.m_estimator) x = convolve(x, layer);
      for (int v = v0; v < v1; ++v)
        for (int u = u0; u < u1; ++u)
          if (visible.at(u, v) > 0) weight.at(u, v) = sigmoid(x.row(0, v - b)[u - a]);
    }
  return weight;
}

Map resized(const Map& in, int width, int height) {
  Map out(width, height);
  const float scale_u = static_cast<float>(in.width) / static_cast<float>(width);
  const float scale_v = static_cast<float>(in.height) / static_cast<float>(height);
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u) {
      const float x = std::max((static_cast<float>(u) + 0.5f) * scale_u - 0.5f, 0.0f);
      const float y = std::max((static_cast<float>(v) + 0.5f) * scale_v - 0.5f, 0.0f);
      const int u0 = std::min(static_cast<int>(x), in.width - 1), u1 = std::min(u0 + 1, in.width - 1);
      const int v0 = std::min(static_cast<int>(y), in.height - 1), v1 = std::min(v0 + 1, in.height - 1);
      const float a = x - static_cast<float>(u0), b = y - static_cast<float>(v0);
      out.at(u, v) =
          (1 - b) * ((1 - a) * in.at(u0, v0) + a * in.at(u1, v0)) + b * ((1 - a) * in.at(u0, v1) + a * in.at(u1, v1));
    }
  return out;
}

std::vector<float> m_estimator_weights(const Model& model, const Template& pixels, const Map& f1, const Camera& level_camera,
                                       const Point& at, Map& weight) {
  Planes in(4, f1.width, f1.height);
  Map visible(f1.width, f1.height);
  const Map prior = weight.data.empty() ? Map() : resized(weight, f1.width, f1.height);
  for (const TemplatePixel& p : pixels) {
    if (!(p.inverse_depth > 0)) continue;
    const Warped w = warp(level_camera, at.T_10, p, f1);
    if (!w.visible) continue;
    const int u = static_cast<int>(p.u), v = static_cast<int>(p.v);
    const double warped = f1.bilinear(w.u, w.v);
    visible.at(u, v) = 1;
    in.row(0, v)[u] = static_cast<float>(std::abs(warped - (at.gain * p.f0 + at.bias)));
    in.row(1, v)[u] = p.f0;
    in.row(2, v)[u] = static_cast<float>(warped);
    in.row(3, v)[u] = prior.data.empty() ? 1.0f : prior.at(u, v);
  }
  weight = m_estimator(model, in, visible);
  std::vector<float> weights(pixels.size(), 0.0f);
  for (size_t k = 0; k < pixels.size(); ++k)
    if (pixels[k].inverse_depth > 0) weights[k] = weight.at(static_cast<int>(pixels[k].u), static_cast<int>(pixels[k].v));
  return weights;
}

}  // namespace iclk::internal
