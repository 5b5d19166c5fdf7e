#pragma once
#include <cmath>
#include <cstdint>
#include <optional>
#include <random>
#include <vector>

#include <Eigen/Core>

#include <iclk/align/camera.h>
#include <iclk/align/features.h>
#include <iclk/align/image.h>
#include <iclk/align/se3.h>

namespace iclk::test {

/// A textured relief seen by two cameras. Texture and depth are analytic functions of image 0's pixels, so image 0 is exact and
/// image 1 is exact up to the intersection of its rays with the relief (1e-9 px): any error is the method's. Unlike a plane, a
/// relief tells a sideways motion from a turn.
struct Relief {
  Camera camera{130, 130, 79.5, 59.5, 160, 120};
  SE3 T_10;                       ///< camera 1: X1 = T_10 X0
  double distance = 4;            ///< mean depth
  double depth_amplitude = 0.25;  ///< of the relief, share of the distance
  double shortest = 7;            ///< finest wavelength of the texture, px
  double longest = 200;
  int waves = 24;                   ///< log-spaced
  double contrast = 0.05;           ///< amplitude of one wave
  std::optional<double> direction;  ///< of every wave (rad): edges of one direction only
  double gain = 1, bias = 0;        ///< I1 = gain I0 + bias
  double noise = 0;                 ///< standard deviation of what is added to every pixel of both images
  uint32_t seed = 1;                ///< of the texture

  /// z of camera 0 at pixel uv of image 0, also beyond its border.
  double depth(const Eigen::Vector2d& uv) const {
    const double a = 2 * M_PI * uv.x() / camera.width, b = 2 * M_PI * uv.y() / camera.height;
    return distance * (1 + depth_amplitude * std::sin(1.3 * a + 0.5) * std::cos(1.1 * b + 0.2));
  }
  /// Where the pixel of image 0 is in image 1.
  Eigen::Vector2d seen_from(const SE3& T, const Eigen::Vector2d& uv0) const {
    return camera.project(T * (camera.ray(uv0) * depth(uv0)));
  }
  Eigen::Vector2d truth(const Eigen::Vector2d& uv0) const { return seen_from(T_10, uv0); }
};

/// Floats of width x height, row-major.
struct Frame {
  int width = 0, height = 0;
  std::vector<float> data;
  float& at(int u, int v) { return data[static_cast<size_t>(v) * width + u]; }
  ImageView view() const { return {data.data(), width, height, 0, PixelFormat::r32f}; }
};

/// Grey value at a pixel of image 0, mean 0.5, in [0, 1] nearly always, never clamped.
class ReliefTexture {
 public:
  explicit ReliefTexture(const Relief& r) : contrast_(r.contrast) {
    std::mt19937 random(r.seed);
    const auto uniform = [&] { return static_cast<double>(random()) / 4294967296.0; };
    for (int k = 0; k < r.waves; ++k) {
      const double f =
          2 * M_PI / (r.shortest * std::pow(r.longest / r.shortest, static_cast<double>(k) / std::max(1, r.waves - 1)));
      const double turn = 2 * M_PI * uniform(), direction = r.direction.value_or(turn), phase = 2 * M_PI * uniform();
      waves_.emplace_back(f * std::cos(direction), f * std::sin(direction), phase);
    }
  }
  double operator()(const Eigen::Vector2d& uv) const {
    double sum = 0;
    for (const Eigen::Vector3d& w : waves_) sum += std::sin(w.x() * uv.x() + w.y() * uv.y() + w.z());
    return 0.5 + contrast_ * sum;
  }

 private:
  double contrast_;
  std::vector<Eigen::Vector3d> waves_;
};

/// `which` 0 or 1. The noise depends on `noise_seed` and `which` alone.
inline Frame render(const Relief& r, int which, uint32_t noise_seed = 0) {
  const Camera& c = r.camera;
  Frame frame{c.width, c.height, std::vector<float>(static_cast<size_t>(c.width) * c.height)};
  const ReliefTexture texture(r);
  const SE3 T_01 = r.T_10.inverse();
  std::mt19937 random(2 * noise_seed + static_cast<uint32_t>(which) + 77);
  std::normal_distribution<double> normal(0, 1);
  double z = r.distance;  // of the last pixel: the next one is near it
  for (int v = 0; v < c.height; ++v)
    for (int u = 0; u < c.width; ++u) {
      Eigen::Vector2d at(u, v);
      if (which == 1) {
        // Where X0(z) = T_01 (ray z) lies on the relief, X0.z = depth(project(X0)), by a fixed point that contracts on smooth
        // reliefs.
        const Eigen::Vector3d ray = T_01.R * c.ray(at);
        for (int i = 0; i < 60; ++i) {
          const Eigen::Vector3d X0 = ray * z + T_01.t;
          if (!(X0.z() > 1e-3)) {
            z = r.distance;
            break;
          }
          at = c.project(X0);
          const double change = (r.depth(at) - X0.z()) / ray.z();
          z += change;
          if (std::abs(change) < 1e-11 * r.distance) break;
        }
      }
      double I = texture(at);
      if (which == 1) I = r.gain * I + r.bias;
      if (r.noise > 0) I += r.noise * normal(random);
      frame.at(u, v) = static_cast<float>(I);
    }
  return frame;
}

/// A chequered wall, squares of 24 px, `right` px further right, with its own noise.
inline Frame chequered(int width, int height, double right, uint32_t noise_seed) {
  std::mt19937 random(noise_seed);
  std::normal_distribution<float> noise(0, 0.005f);
  Frame frame{width, height, std::vector<float>(static_cast<size_t>(width) * height)};
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u) {
      const double wave = std::sin(M_PI * (u - right) / 24) * std::sin(M_PI * v / 24);
      frame.at(u, v) = static_cast<float>(0.5 + 0.3 * std::tanh(6 * wave)) + noise(random);
    }
  return frame;
}

/// n features at sub-pixel places at least `border` px inside image 0, with exact inverse depths.
inline Features random_features(const Relief& r, int n, uint32_t seed = 1, double border = 12) {
  std::mt19937 random(seed);
  const auto uniform = [&] { return static_cast<double>(random()) / 4294967296.0; };
  Features features;
  for (int i = 0; i < n; ++i) {
    const double u = border + uniform() * (r.camera.width - 1 - 2 * border),
                 v = border + uniform() * (r.camera.height - 1 - 2 * border);
    features.uv.emplace_back(u, v);
    features.inverse_depth.push_back(1 / r.depth({u, v}));
  }
  return features;
}

/// Mean distance in image 1 (px) between where T and where the truth put the features.
inline double pixel_error(const Relief& r, const Features& features, const SE3& T) {
  double sum = 0;
  for (const Eigen::Vector2d& uv : features.uv) sum += (r.seen_from(T, uv) - r.truth(uv)).norm();
  return sum / features.size();
}

/// Inverse depth of every pixel, for dense mode.
inline Frame inverse_depth_frame(const Relief& r) {
  Frame frame{r.camera.width, r.camera.height, std::vector<float>(static_cast<size_t>(r.camera.width) * r.camera.height)};
  for (int v = 0; v < frame.height; ++v)
    for (int u = 0; u < frame.width; ++u) frame.at(u, v) = static_cast<float>(1 / r.depth(Eigen::Vector2d(u, v)));
  return frame;
}

}  // namespace iclk::test
