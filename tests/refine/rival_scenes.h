#pragma once
// Walls of which one pose does not explain all.
#include <cmath>
#include <functional>

#include "../support/relief.h"

namespace iclk::test::rivals {

constexpr double kDistance = 4;
inline const Camera kCamera{260, 260, 159.5, 119.5, 320, 240};

/// A wall at kDistance, its grey values by X and Y in metres.
inline Frame render(const std::function<double(double, double)>& wall, const SE3& T_10, uint32_t seed) {
  Frame frame{kCamera.width, kCamera.height, std::vector<float>(static_cast<size_t>(kCamera.width * kCamera.height))};
  const SE3 T_01 = T_10.inverse();
  std::mt19937 random(seed);
  std::normal_distribution<double> noise(0, 0.004);
  for (int v = 0; v < frame.height; ++v)
    for (int u = 0; u < frame.width; ++u) {
      const Eigen::Vector3d ray = T_01.R * kCamera.ray(Eigen::Vector2d(u, v));
      const Eigen::Vector3d X = T_01.t + ray * ((kDistance - T_01.t.z()) / ray.z());
      frame.at(u, v) = static_cast<float>(wall(X.x(), X.y()) + noise(random));
    }
  return frame;
}

inline Features lattice(double depth) {
  Features f;
  for (int v = 16; v < kCamera.height - 16; v += 16)
    for (int u = 16; u < kCamera.width - 16; u += 16) {
      f.uv.emplace_back(u, v);
      f.inverse_depth.push_back(1 / depth);
    }
  return f;
}

/// Waves that repeat every `period` m where it is positive.
class Waves {
 public:
  Waves(double period, uint32_t seed) {
    std::mt19937 random(seed);
    const auto uniform = [&] { return static_cast<double>(random()) / 4294967296.0; };
    for (int k = 0; k < 30; ++k) {
      const double size = 2 + 22 * uniform(), way = 2 * M_PI * uniform();
      double fx = size * std::cos(way), fy = size * std::sin(way);
      if (period > 0) {
        fx = 2 * M_PI / period * std::round(fx / 4);
        fy = 2 * M_PI / period * std::round(fy / 4);
      }
      waves_.push_back({fx, fy, 2 * M_PI * uniform()});
    }
  }
  double operator()(double x, double y) const {
    double sum = 0;
    for (const auto& [fx, fy, phase] : waves_) sum += std::sin(fx * x + fy * y + phase);
    return sum;
  }

 private:
  std::vector<std::array<double, 3>> waves_;
};

inline double error(const SE3& T, const SE3& truth) {  // px, the worst of the lattice
  double most = 0;
  for (const Eigen::Vector2d& uv : lattice(kDistance).uv) {
    const Eigen::Vector3d X = kCamera.ray(uv) * kDistance;
    most = std::max(most, (kCamera.project(T * X) - kCamera.project(truth * X)).norm());
  }
  return most;
}

inline SE3 sideways(double x, double y) { return SE3::exp((Vector6d() << x, y, 0.02, 0.002, -0.003, 0.004).finished()); }

constexpr double kPeriod = 0.7;  // 45 px

/// The same rows of both images from another picture.
inline void overlay(Frame& frame, const Frame& with, int first, int last) {
  for (int v = first; v < last; ++v)
    for (int u = 0; u < frame.width; ++u) frame.at(u, v) = with.data[static_cast<size_t>(v * frame.width + u)];
}

}  // namespace iclk::test::rivals
