#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/align/image.h>
#include <iclk/align/se3.h>

namespace iclk::test {

/// A smooth textured slanted plane n.X = d of camera 0, seen by two cameras: the texture is analytic, so both images are exact
/// and any error is the method's. The C++ sister of the executable specification's synthetic_pair().
struct Scene {
  Camera camera{112.8, 112.8, 93.5, 59.5, 188, 120};
  SE3 T_10;  ///< camera 1: X1 = T_10 X0
  Eigen::Vector3d normal{0.15, -0.1, 1.0};
  double distance = 80;
  /// Finest wavelength of the texture, px at the image centre. Below about 4 px, sampling on pixels is itself the largest
  /// error.
  double shortest = 8;
  int waves = 24;             ///< log-spaced up to 32 times the shortest
  double contrast = 0.055;    ///< amplitude of one wave
  double gain = 1, bias = 0;  ///< I1 = gain I0 + bias
  double noise = 0;           ///< standard deviation of what is added to every pixel of both images
  uint32_t seed = 1;

  /// z of camera 0 along the ray of uv.
  double depth(const Eigen::Vector2d& uv) const { return distance / normal.dot(camera.ray(uv)); }

  /// Where the pixel of image 0 is in image 1.
  Eigen::Vector2d truth(const Eigen::Vector2d& uv0) const { return camera.project(T_10 * (camera.ray(uv0) * depth(uv0))); }
};

/// Floats of camera.width x camera.height, row-major.
struct Picture {
  int width = 0, height = 0;
  std::vector<float> data;
  ImageView view() const { return {data.data(), width, height, 0, PixelFormat::r32f}; }
};

/// The surface's grey value over (X, Y) of camera 0; in [0, 1] nearly always, never clamped.
class Texture {
 public:
  explicit Texture(const Scene& scene) : contrast_(scene.contrast) {
    std::mt19937 random(scene.seed);
    const auto uniform = [&] { return static_cast<double>(random()) / 4294967296.0; };
    const double px_per_unit = std::abs(scene.camera.fx) / scene.distance;
    for (int k = 0; k < scene.waves; ++k) {
      const double wavelength = scene.shortest * std::pow(32.0, static_cast<double>(k) / std::max(1, scene.waves - 1));
      const double f = 2 * M_PI / wavelength * px_per_unit, direction = 2 * M_PI * uniform(), phase = 2 * M_PI * uniform();
      waves_.push_back({f * std::cos(direction), f * std::sin(direction), phase});
    }
  }
  double operator()(const Eigen::Vector3d& X0) const {
    double sum = 0;
    for (const Eigen::Vector3d& w : waves_) sum += std::sin(w.x() * X0.x() + w.y() * X0.y() + w.z());
    return 0.5 + contrast_ * sum;
  }

 private:
  double contrast_;
  std::vector<Eigen::Vector3d> waves_;
};

/// `which` 0: image 0; 1: image 1. The noise of a picture depends on `noise_seed` alone.
inline Picture render(const Scene& scene, int which, uint32_t noise_seed = 0) {
  const Camera& c = scene.camera;
  Picture picture{c.width, c.height, std::vector<float>(static_cast<size_t>(c.width) * c.height)};
  const SE3 T_1c = which == 1 ? scene.T_10 : SE3{};
  const Texture texture(scene);
  const Eigen::Vector3d n1 = T_1c.R * scene.normal;
  const SE3 T_c1 = T_1c.inverse();
  std::mt19937 random(2 * noise_seed + static_cast<uint32_t>(which));
  std::normal_distribution<double> normal(0, 1);
  for (int v = 0; v < c.height; ++v)
    for (int u = 0; u < c.width; ++u) {
      const Eigen::Vector3d ray = c.ray({u, v});
      const double z = (scene.distance + n1.dot(T_1c.t)) / n1.dot(ray);
      double I = texture(T_c1 * (ray * z));
      if (which == 1) I = scene.gain * I + scene.bias;
      if (scene.noise > 0) I += scene.noise * normal(random);
      picture.data[static_cast<size_t>(v) * c.width + u] = static_cast<float>(I);
    }
  return picture;
}

/// n features at sub-pixel places at least `border` px inside image 0, with exact inverse depths.
inline Features random_features(const Scene& scene, int n, uint32_t seed, double border = 17) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> u(border, scene.camera.width - 1 - border),
      v(border, scene.camera.height - 1 - border);
  Features features;
  for (int i = 0; i < n; ++i) {
    const double a = u(random), b = v(random);
    features.uv.emplace_back(a, b);
    features.inverse_depth.push_back(1 / scene.depth({a, b}));
  }
  return features;
}

}  // namespace iclk::test
