#include <cmath>
#include <cstdio>
#include <vector>

#include <iclk/align/aligner.h>
#include <iclk/engine/error.h>
#ifdef WITH_SESSION
#include <iclk/iclk.h>
#endif

// Aligns a synthetic image to itself shifted by two pixels: a plane 1 m away, so the camera moved by 2 / 80 m.
int main() try {
  const int size = 64;
  std::vector<float> image0, image1;
  auto texture = [](double u, double v) {
    return float(0.5 + 0.2 * std::sin(0.35 * u) * std::cos(0.3 * v) + 0.15 * std::sin(0.13 * u + 0.2 * v));
  };
  for (int v = 0; v < size; ++v)
    for (int u = 0; u < size; ++u) {
      image0.push_back(texture(u, v));
      image1.push_back(texture(u - 2, v));
    }
  auto view = [&](const std::vector<float>& image) {
    return iclk::ImageView{.data = image.data(), .width = size, .height = size, .format = iclk::PixelFormat::r32f};
  };

  iclk::Reference reference{.image = view(image0), .camera = {80, 80, 31.5, 31.5, size, size}};
  for (int v = 12; v < 52; v += 10)
    for (int u = 12; u < 52; u += 10) {
      reference.features.uv.push_back({u, v});
      reference.features.inverse_depth.push_back(1);
    }

  auto aligner = iclk::make_cpu_aligner({.width = size, .height = size}, {.levels = 2});
  aligner->set_reference(0, reference);
  const iclk::Alignment result = aligner->align({.target = view(image1)});
#ifdef WITH_SESSION
  const iclk::SessionOptions options{
      .model = "classical", .solver = iclk::Solver::cpu, .search = iclk::SearchMode::off, .levels = 2, .refine = false};
  if (iclk::align(reference, view(image1), options).T_10.matrix() != result.T_10.matrix()) return 3;
#endif
  std::printf("%s: %s, t = %.4f %.4f %.4f m\n", iclk::name(result.status), result.reason.c_str(), result.T_10.t.x(),
              result.T_10.t.y(), result.T_10.t.z());
  return result.converged() && std::abs(result.T_10.t.x() - 2.0 / 80) < 2e-3 ? 0 : 1;
} catch (const iclk::Error& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 2;
}
